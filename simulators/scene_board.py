"""The printed ChArUco board: a flat picture on a plane."""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from simulators.layout import BoardLayout
from simulators.scene import Array, Floats, Hits, Mask, Material

PIXELS_PER_MM = 20
WHITE, BLACK = 0.85, 0.04  # albedo of paper and ink
# Standard deviation of the print's edges. As wide as the spacing of the rays on the board asks for: of a sharper edge
# rays tell the place in steps only, and corners would be found where they are not.
INK_SPREAD_MM = 0.09


@dataclass(frozen=True)
class BoardScene:
    """The board; the scene's frame is the board's: z = 0 is the print, columns run along +x, rows along -y."""

    board: BoardLayout

    def __post_init__(self) -> None:
        object.__setattr__(self, "_print", _print(self.board))

    def trace(self, origin: Array, directions: Array) -> Hits:
        """First hits of rays from one origin (3,) along unit directions (n, 3); the back cannot be seen."""
        height_px, width_px = self.__dict__["_print"].shape
        half = np.array([width_px, height_px]) / (PIXELS_PER_MM * 2e3)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = -origin[2] / directions[:, 2]
            points = origin + distance[:, None] * directions
            seen = (distance > 0) & (origin[2] > 0) & np.all(np.abs(points[:, :2]) < half, axis=1)
        ray = np.flatnonzero(seen)
        points = points[ray] * (1.0, 1.0, 0.0)
        albedo = self._albedo(points, half)
        normals = np.tile(np.array([0, 0, 1], np.float32), (len(ray), 1))
        material = Material(albedo, np.zeros(len(ray), np.float32), np.ones(len(ray), np.float32))
        return Hits(ray, points, normals, material)

    def lit(self, hits: Hits, source: Array) -> Mask:
        """Which hits (n,) see the point source (3,): all or none."""
        return np.full(len(hits.points), source[2] > 0)

    def _albedo(self, points: Array, half: Array) -> Floats:
        col = (points[:, 0] + half[0]) * 1e3 * PIXELS_PER_MM - 0.5
        row = (half[1] - points[:, 1]) * 1e3 * PIXELS_PER_MM - 0.5
        ink = map_coordinates(self.__dict__["_print"], [row, col], order=1, mode="nearest")
        return np.repeat(ink.reshape(-1, 1), 3, axis=1)


def _print(layout: BoardLayout) -> Floats:
    """Albedo of the print, margin included, `PIXELS_PER_MM` squared per square millimetre."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, layout.dictionary))
    board = cv2.aruco.CharucoBoard((layout.columns, layout.rows), layout.square_m, layout.marker_m, dictionary)
    square_px = round(layout.square_m * 1e3 * PIXELS_PER_MM)
    picture = board.generateImage((layout.columns * square_px, layout.rows * square_px), marginSize=0)
    margin_px = round(layout.margin_m * 1e3 * PIXELS_PER_MM)
    ink = np.pad(np.asarray(picture), margin_px, constant_values=255).astype(np.float32) / 255
    soft = gaussian_filter(ink, INK_SPREAD_MM * PIXELS_PER_MM, mode="nearest")
    return np.asarray(BLACK + (WHITE - BLACK) * soft, np.float32)
