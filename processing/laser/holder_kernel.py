"""Which part of the sample holder each pixel sees, in one pass over the pixels' rays."""

import math

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

Array = NDArray[np.float64]
View = tuple[Array, Array]  # the camera's centre and the laser's place, rig frame
Box = tuple[Array, Array, float, float]  # sample_from_rig, half sides of opening and frames, the frame's step, safety
NOTHING, UPPER, LOWER, OPENING = range(4)


@njit(inline="always")
def _hit(rays: Array, centre: Array, r: int, c: int, z_m: float) -> tuple[float, float]:
    """Where a pixel's ray meets a height, rig frame; NaN where it does not."""
    way = (z_m - centre[2]) / rays[r, c, 2]
    if not way > 0.0 or way == np.inf:
        return np.nan, np.nan
    return centre[0] + way * rays[r, c, 0], centre[1] + way * rays[r, c, 1]


@njit(inline="always")
def to_sample(turn: Array, x: float, y: float, z: float) -> tuple[float, float]:
    """The two level coordinates in the sample's frame of a point of the rig's."""
    return (
        turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z + turn[0, 3],
        turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z + turn[1, 3],
    )


@njit(inline="always")
def _apart(rays: Array, centre: Array, a: tuple[int, int], b: tuple[int, int]) -> float:
    """Distance per pixel between the hits of two pixels of one row or column on the reference plane."""
    ax, ay = _hit(rays, centre, a[0], a[1], 0.0)
    bx, by = _hit(rays, centre, b[0], b[1], 0.0)
    return math.hypot(bx - ax, by - ay) / (b[0] - a[0] + b[1] - a[1])


@njit(inline="always")
def _footprint(rays: Array, centre: Array, r: int, c: int) -> float:
    """Length of a pixel's larger side on the reference plane."""
    bottom, right = rays.shape[0] - 1, rays.shape[1] - 1
    down = _apart(rays, centre, (max(r - 1, 0), c), (min(r + 1, bottom), c))
    across = _apart(rays, centre, (r, max(c - 1, 0)), (r, min(c + 1, right)))
    return down + across if np.isnan(down + across) else max(down, across)  # NaN of a single row or column


@njit(inline="always")
def _ring_at(x: float, y: float, dx: float, dy: float, share: float) -> float:
    """Half side of the square on which a point of a way lies; infinity beyond the way's ends."""
    if not 0.0 <= share <= 1.0:
        return np.inf
    return max(abs(x + share * dx), abs(y + share * dy))


@njit(inline="always")
def _nearest_ring(x: float, y: float, dx: float, dy: float) -> float:
    """The least half side along a way: at its ends, or where one coordinate is 0, or where both are as large."""
    ends = min(max(abs(x), abs(y)), max(abs(x + dx), abs(y + dy)))
    middle = min(_ring_at(x, y, dx, dy, -x / dx), _ring_at(x, y, dx, dy, -y / dy))
    corner = min(_ring_at(x, y, dx, dy, (y - x) / (dx - dy)), _ring_at(x, y, dx, dy, -(x + y) / (dx + dy)))
    return min(ends, middle, corner)


@njit(inline="always")
def _sees_lower(view: View, box: Box, upper: tuple[float, float], lower: tuple[float, float], margin: float) -> bool:
    """Whether neither the view ray nor the laser's passes through the upper frame, nor near the lower one's edges."""
    turn, sides, step, _ = box
    source = view[1]
    x, y = to_sample(turn, lower[0], lower[1], -step)
    ring = max(abs(x), abs(y))
    if not (ring > sides[1] + margin and ring < sides[2] - margin):
        return False
    share = step / (source[2] + step)
    lit_x, lit_y = lower[0] + share * (source[0] - lower[0]), lower[1] + share * (source[1] - lower[1])
    for end_x, end_y in (upper, (lit_x, lit_y)):
        ux, uy = to_sample(turn, end_x, end_y, 0.0)
        if not _nearest_ring(x, y, ux - x, uy - y) > sides[1] + margin:
            return False
    return True


@njit(parallel=True, cache=True, error_model="numpy")
def see_holder(rays: Array, view: View, box: Box, part: NDArray[np.uint8], points: Array) -> None:
    """Write every pixel's part (h, w) and, on the white frame, the point that it sees (h, w, 3); see `holder`."""
    turn, sides, step, safety = box
    centre = view[0]
    height, width = part.shape
    for r in prange(height):
        for c in range(width):
            part[r, c] = NOTHING
            points[r, c, :] = np.nan
            upper = _hit(rays, centre, r, c, 0.0)
            x, y = to_sample(turn, upper[0], upper[1], 0.0)
            ring = max(abs(x), abs(y))
            lower = _hit(rays, centre, r, c, -step)
            if ring < sides[0]:
                part[r, c] = OPENING
                continue
            margin = _footprint(rays, centre, r, c) / 2 + safety
            if ring > sides[0] + margin and ring < sides[1] - margin:
                part[r, c] = UPPER
                points[r, c, 0], points[r, c, 1], points[r, c, 2] = upper[0], upper[1], 0.0
            elif _sees_lower(view, box, upper, lower, margin):
                part[r, c] = LOWER
                points[r, c, 0], points[r, c, 1], points[r, c, 2] = lower[0], lower[1], -step
