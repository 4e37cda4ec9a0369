"""The loop of rectification, compiled by numba; its plain NumPy twin is in tests/reference."""

import math

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from processing.radiometry import merge_kernel

SEEN, OUT_OF_FIELD, SATURATED, MISSING = 0, 1, 2, 3
ENOUGH = 0.5  # share of a footprint that must be measured
SATURATED_SHARE = 0.01  # of a footprint that may be saturated: leaving bright pixels out makes the rest too dark

Quad = tuple[float, float, float, float, float, float, float, float]
Box = tuple[int, int, int, int]


@njit(inline="always")
def _box(corners_px: NDArray[np.float64], row: int, column: int, reach: int) -> Box:
    """Left, top, width and height of the pixels that tents of half width `reach` in the texel can reach.

    Width 0 where the texel has no image.
    """
    low_u, high_u, low_v, high_v = np.inf, -np.inf, np.inf, -np.inf
    for i in range(row, row + 2):
        for j in range(column, column + 2):
            u, v = corners_px[i, j, 0], corners_px[i, j, 1]
            if not math.isfinite(u + v):
                return 0, 0, 0, 0
            low_u, high_u, low_v, high_v = min(low_u, u), max(high_u, u), min(low_v, v), max(high_v, v)
    if max(abs(low_u), abs(high_u), abs(low_v), abs(high_v)) > 1e6:
        return 0, 0, 0, 0
    left, top = math.floor(low_u) - reach + 1, math.floor(low_v) - reach + 1
    # One pixel more than the tents need, for points that rounding lifts to the next pixel.
    return left, top, math.floor(high_u) + reach - left + 2, math.floor(high_v) + reach - top + 2


@njit(inline="always")
def _is_near(box: Box, height: int, width: int) -> bool:
    """Whether a footprint touches the image and could be half inside."""
    left, top, columns, rows = box
    touches = columns > 0 and left < width and top < height and left + columns > 0 and top + rows > 0
    return touches and max(columns, rows) <= 2 * max(height, width) + 8


@njit(inline="always")
def _spread_points(window: NDArray[np.float64], quad: Quad, box: Box, reach: int) -> None:
    """Add to `window` points over the quadrilateral, each shared bilinearly between its four pixels.

    `quad` = u v of its corners in the texel's row order. The points are at most half a tent apart; their weights add
    up to 1 / reach^2.
    """
    u00, v00, u01, v01, u10, v10, u11, v11 = quad
    density = 2.0 / reach
    across = max(1, math.ceil(density * max(math.hypot(u01 - u00, v01 - v00), math.hypot(u11 - u10, v11 - v10))))
    down = max(1, math.ceil(density * max(math.hypot(u10 - u00, v10 - v00), math.hypot(u11 - u01, v11 - v01))))
    share = 1.0 / (across * down * reach * reach)
    for i in range(down):
        b = (i + 0.5) / down
        u, v = u00 + b * (u10 - u00) - box[0], v00 + b * (v10 - v00) - box[1]
        step_u = (u01 + b * (u11 - u01) - box[0] - u) / across
        step_v = (v01 + b * (v11 - v01) - box[1] - v) / across
        for j in range(across):
            x, y = u + (j + 0.5) * step_u, v + (j + 0.5) * step_v
            column, row = int(x), int(y)
            f, g = x - column, share * (y - row)
            window[row, column] += (1.0 - f) * (share - g)
            window[row, column + 1] += f * (share - g)
            window[row + 1, column] += (1.0 - f) * g
            window[row + 1, column + 1] += f * g


@njit(inline="always")
def _widen(window: NDArray[np.float64], rows: int, columns: int) -> None:
    """Turn tents of half width one into tents of half width two: at whole pixels, convolve with 1/2 1 1/2 each way."""
    for y in range(rows):
        before = 0.0
        for x in range(columns):
            here = window[y, x]
            after = window[y, x + 1] if x + 1 < columns else 0.0
            window[y, x] = here + 0.5 * (before + after)
            before = here
    for x in range(columns):
        before = 0.0
        for y in range(rows):
            here = window[y, x]
            after = window[y + 1, x] if y + 1 < rows else 0.0
            window[y, x] = here + 0.5 * (before + after)
            before = here


@njit(inline="always")
def _weigh(
    window: NDArray[np.float64], corners_px: NDArray[np.float64], texel: tuple[int, int], box: Box, reach: int
) -> None:
    """Weights of the pixels from `box`'s corner on in a texel's mean: its area, blurred by tents of half width `reach`.

    Over all pixels they add up to 1.
    """
    r, s = texel
    window[: box[3], : box[2]] = 0.0
    a, b, c, d = corners_px[r, s], corners_px[r, s + 1], corners_px[r + 1, s], corners_px[r + 1, s + 1]
    _spread_points(window, (a[0], a[1], b[0], b[1], c[0], c[1], d[0], d[1]), box, reach)
    if reach == 2:
        _widen(window, box[3], box[2])


@njit(inline="always")
def _gather(
    image: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint8]],
    channel: NDArray[np.uint8],
    window: NDArray[np.float64],
    box: Box,
    sums: NDArray[np.float64],
) -> None:
    """Into `sums` (5, c): weight, weighted value and squared-weight variance of the measured pixels under the window.

    Then the weight of the saturated pixels and of those that are missing for another reason.
    """
    value, variance, status = image
    height, width, planes = value.shape
    left, top, columns, rows = box
    sums[:] = 0.0
    for y in range(max(top, 0), min(top + rows, height)):
        for x in range(max(left, 0), min(left + columns, width)):
            weight = window[y - top, x - left]
            if weight <= 0.0:
                continue
            for p in range(planes):
                c = channel[y & 1, x & 1, p]
                pixel = float(value[y, x, p])
                if math.isfinite(pixel):
                    sums[0, c] += weight
                    sums[1, c] += weight * pixel
                    sums[2, c] += weight * weight * float(variance[y, x, p])
                elif status[y, x, p] == merge_kernel.SATURATED:
                    sums[3, c] += weight
                else:
                    sums[4, c] += weight


@njit(inline="always")
def _verdict(sums: NDArray[np.float64], c: int, share: float) -> int:
    """Whether a channel's footprint was measured, and if not, why."""
    total, saturated, missing = sums[0, c], sums[3, c], sums[4, c]
    if saturated > SATURATED_SHARE * share:
        return SATURATED
    if total >= ENOUGH * share:
        return SEEN
    return MISSING if missing > share - total - saturated - missing else OUT_OF_FIELD


@njit(parallel=True, cache=True)
def resample(
    value: NDArray[np.float32],
    variance: NDArray[np.float32],
    status: NDArray[np.uint8],
    channel: NDArray[np.uint8],
    corners_px: NDArray[np.float64],
    reach: int,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint8]]:
    """Means (n, m, 3), variances and verdicts (n, m) of an image (h, w, p); see `rectification.rectify`.

    `channel` (2, 2, p) is the colour of each plane of a pixel by its row and column modulo two, `corners_px`
    (n + 1, m + 1, 2). A texel's verdict is its worst channel's.
    """
    height, width = value.shape[:2]
    rows, columns = corners_px.shape[0] - 1, corners_px.shape[1] - 1
    mean = np.full((rows, columns, 3), np.nan, np.float32)
    spread = np.full((rows, columns, 3), np.nan, np.float32)
    verdict = np.full((rows, columns), OUT_OF_FIELD, np.uint8)
    share = np.zeros(3)
    for colour in channel.ravel():
        share[colour] += 0.25
    for r in prange(rows):
        window = np.zeros((1, 1))
        sums = np.zeros((5, 3))
        for s in range(columns):
            box = _box(corners_px, r, s, reach)
            if not _is_near(box, height, width):
                continue
            if box[3] > window.shape[0] or box[2] > window.shape[1]:
                window = np.zeros((max(box[3], window.shape[0]), max(box[2], window.shape[1])))
            _weigh(window, corners_px, (r, s), box, reach)
            _gather((value, variance, status), channel, window, box, sums)
            verdict[r, s] = max(_verdict(sums, 0, share[0]), _verdict(sums, 1, share[1]), _verdict(sums, 2, share[2]))
            for c in range(3):
                if _verdict(sums, c, share[c]) == SEEN:
                    mean[r, s, c] = sums[1, c] / sums[0, c]
                    spread[r, s, c] = sums[2, c] / (sums[0, c] * sums[0, c])
    return mean, spread, verdict
