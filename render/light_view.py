"""The scene as a directional light sees it, which is what a shadow map holds."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from render.arrays import Float64, Rows, unit

# Pixels along each side of a shadow map, and how many of them stay free around what it shows.
SIDE_PX = 512
_MARGIN_PX = 2
# Of a body's extent: what is thinner is a plane, which keeps no light from itself.
_FLAT = 1e-6


@dataclass(frozen=True, eq=False)
class LightView:
    """Parallel rays from a light, one for each pixel of a square image.

    `image_from_world` (3, 4) takes world points (x, y, z, 1) to an image point (u, v) in pixels, whose centres are at
    integers, and to the distance in world units along the rays, which start on a plane before all bodies.
    """

    image_from_world: Float64
    side_px: int

    @property
    def pixel(self) -> float:
        """Side of a pixel in world units."""
        return float(1.0 / np.linalg.norm(self.image_from_world[0, :3]))

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.side_px, self.side_px

    def in_image(self, points: Rows) -> Float64:
        """Image points and distances (n, 3) of world points (n, 3)."""
        return np.asarray(points @ self.image_from_world[:, :3].T + self.image_from_world[:, 3])

    def projected(self, points: Rows) -> Float64:
        """World points (n, 3) as homogeneous image points, with 1 for the depth: parallel rays need no division."""
        return np.column_stack([self.in_image(points)[:, :2], np.ones(len(points))])

    def distance(self, points: Rows) -> Float64:
        """How far along the rays world points (n, 3) lie, in world units."""
        return self.in_image(points)[:, 2]

    def toward(self, points: Rows) -> Float64:
        """Unit vectors (n, 3) from world points to the light."""
        return np.broadcast_to(-self.image_from_world[2, :3], points.shape)


def light_view(direction: Rows, positions: Sequence[Rows], side_px: int = SIDE_PX) -> LightView:
    """The view along a unit direction (3,) toward the light that shows where bodies may keep light from each other.

    `positions` are the vertices (n, 3) of each body. A shadow needs two surfaces one behind the other: two bodies where
    their boxes in the image overlap, or one that is not flat. The image is fitted to those places.
    """
    axis = np.eye(3)[np.argmin(np.abs(direction))]
    right = unit(np.cross(axis, direction))
    axes = np.stack([right, np.cross(right, direction), -np.asarray(direction)])
    seen = [rows @ axes.T for rows in positions]
    low, high = _region(seen)
    scale = (side_px - 1 - 2 * _MARGIN_PX) / max(float((high - low).max()), 1e-30)
    first = min(float(rows[:, 2].min()) for rows in seen)
    shift = np.append(0.5 * (side_px - 1) - 0.5 * scale * (low + high), -first)
    return LightView(np.column_stack([np.array([[scale], [scale], [1.0]]) * axes, shift]), side_px)


def _region(seen: Sequence[Rows]) -> tuple[Float64, Float64]:
    """Corners (2,) of the box around all overlaps of bodies' boxes, and around the bodies that are not flat."""
    boxes = [(rows[:, :2].min(axis=0), rows[:, :2].max(axis=0)) for rows in seen]
    wanted = [box for box, rows in zip(boxes, seen, strict=True) if not _is_flat(rows)]
    for number, (low, high) in enumerate(boxes):
        for other_low, other_high in boxes[:number]:
            overlap = np.maximum(low, other_low), np.minimum(high, other_high)
            if (overlap[0] < overlap[1]).all():
                wanted.append(overlap)
    lows, highs = zip(*(wanted or boxes), strict=True)
    return np.min(lows, axis=0), np.max(highs, axis=0)


def _is_flat(rows: Rows) -> bool:
    centred = rows - rows.mean(axis=0)
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(centred.T @ centred), 0.0))
    return bool(spread[0] <= _FLAT * spread[2])
