"""The printed ChArUco board: a flat picture on a plane."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numba
import numpy as np
from scipy.ndimage import gaussian_filter

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

    @cached_property
    def _print(self) -> Floats:
        return _print(self.board)

    def trace(self, origin: Array, directions: Array) -> Hits:
        """First hits of rays from one origin (3,) along unit directions (n, 3); the back cannot be seen."""
        points = np.empty((len(directions), 3))
        ink = np.full(len(directions), -1, np.float32)
        if origin[2] > 0:
            _look(origin, np.ascontiguousarray(directions), self._print, PIXELS_PER_MM * 1e3, (points, ink))
        ray = np.flatnonzero(ink >= 0)
        points, albedo = points[ray], np.repeat(ink[ray][:, None], 3, axis=1)
        normals = np.tile(np.array([0, 0, 1], np.float32), (len(ray), 1))
        material = Material(albedo, np.zeros(len(ray), np.float32), np.ones(len(ray), np.float32))
        return Hits(ray, points, normals, material)

    def lit(self, hits: Hits, source: Array) -> Mask:
        """Which hits (n,) see the point source (3,): all or none."""
        return np.full(len(hits.points), source[2] > 0)


@numba.njit(cache=True)
def _look(origin: Array, directions: Array, picture: Floats, scale: float, out: tuple[Array, Floats]) -> None:
    """Points (n, 3) on the print and its bilinear albedo there (n,), left as they are where a ray misses."""
    points, ink = out
    height, width = picture.shape
    for i in range(len(directions)):
        if directions[i, 2] >= 0.0:
            continue
        distance = -origin[2] / directions[i, 2]
        x, y = origin[0] + distance * directions[i, 0], origin[1] + distance * directions[i, 1]
        col, row = x * scale + width / 2, height / 2 - y * scale
        if not (0 < col < width and 0 < row < height):
            continue
        col, row = min(max(col - 0.5, 0.0), width - 1.0), min(max(row - 0.5, 0.0), height - 1.0)
        c, r = min(int(col), width - 2), min(int(row), height - 2)
        upper = picture[r, c] * (c + 1 - col) + picture[r, c + 1] * (col - c)
        lower = picture[r + 1, c] * (c + 1 - col) + picture[r + 1, c + 1] * (col - c)
        ink[i] = upper * (r + 1 - row) + lower * (row - r)
        points[i, 0], points[i, 1], points[i, 2] = x, y, 0.0


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
