"""The ridge of a laser stripe in one image, to a fraction of a pixel, whatever its direction.

It serves images that are no sweep: a stripe photographed on boards, a laser swept by hand, an object that moves under
a laser that stands.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from processing.errors import ImageError

Array = NDArray[np.float64]
_OWN_PIXEL = 0.6  # pixels from a ridge point to its pixel's centre: half, and what noise moves it
_TRUNCATE = 4.0  # sigmas that a filter reaches
_APART = 3.0  # sigmas between ridges that are two: nearer ones melt into one
_PARTS = 16  # of an image's rows, which the cores share
_WORTH_SHARING = 4_000_000  # taps, times five: about four milliseconds
_LINES = 40  # that tell the stripe's width
_SIGMAS_PX = np.geomspace(0.8, 10.0, 9)


@dataclass(frozen=True)
class Ridge:
    """Points (n, 2) uv_px on the stripe's middle, one per scan line, with the ridge's strength (n,) in image units.

    `lines` (n,) are the scan lines' numbers. `rival` (n,) is the strength of the next strongest ridge on the same one,
    more than three sigma away; 0 where there is none over the threshold: what nearly equals the stripe may be it.
    """

    uv_px: Array
    strength: Array
    rival: Array
    lines: NDArray[np.intp]

    def deviation_px(self, noise: float) -> Array:
        """Standard deviation (n,) of the points across the stripe where pixels have independent noise of this size.

        White noise in the slope over the curvature: noise / (sqrt(8 pi) strength); for sigma of a pixel or more.
        """
        return np.asarray(noise / (np.sqrt(8.0 * np.pi) * self.strength))


def stripe_ridge(
    image: NDArray[np.floating], sigma_px: float, threshold: float, mask: NDArray[np.bool_] | None = None
) -> Ridge:
    """The strongest ridge point of every scan line (row) of an image (h, w), where it is stronger than `threshold`.

    Second derivatives of the Gaussian-filtered image give the ridge's direction and, along it, the sub-pixel place
    (Steger 1998, section 3), exact for a Gaussian profile. `sigma_px` is about that of the stripe's profile, and at
    least half its width over sqrt(3) where its core is saturated. Strength is -sigma^2 times the second derivative.
    Scan along columns by passing the transpose. Nothing is found within four sigma of NaN.
    Raises ImageError where image and mask do not fit.
    """
    values = np.asarray(image)
    if values.ndim != 2 or (mask is not None and mask.shape != values.shape):
        raise ImageError(f"a grey image (h, w) and a mask of its shape are needed, not {np.shape(image)}.")
    wanted = np.ones(values.shape, np.bool_) if mask is None else mask
    if not wanted.any():
        return Ridge(np.empty((0, 2)), np.empty(0), np.empty(0), np.empty(0, np.intp))
    filters = _filters(sigma_px)
    margin = filters.shape[1] - 1
    rows, columns = (_span(np.asarray(wanted.any(axis=axis))) for axis in (1, 0))
    part = _with_margin(values, rows, columns, margin)
    found = np.empty((rows.stop - rows.start, 4))
    # Waking the other cores takes longer than a small image does.
    search = _ridge_rows if part.size * filters.shape[1] > _WORTH_SHARING else _some_rows
    inner = np.ascontiguousarray(wanted[rows, columns])
    search(part, inner, filters, sigma_px, (threshold / sigma_px**2, _APART * sigma_px), found)
    found[:, 2:] *= sigma_px**2
    kept = found[:, 2] > 0.0
    uv_px = found[kept, :2] + [columns.start, rows.start]
    return Ridge(uv_px, found[kept, 2], found[kept, 3], np.flatnonzero(kept) + rows.start)


def stripe_sigma(image: NDArray[np.floating]) -> float:
    """Sigma of the stripe's profile in an image (h, w), in pixels: the scale at which its ridge responds most.

    The response sigma^(3/2) |second derivative| of a Gaussian profile is largest where the filter's sigma is the
    profile's own (Lindeberg 1998, section 6). 0.8 to 10 px.
    """
    step = max(np.shape(image)[0] // _LINES, 1)
    response = []
    for sigma_px in _SIGMAS_PX:
        mask = np.zeros(np.shape(image), np.bool_)
        mask[step // 2 :: step] = True
        ridge = stripe_ridge(image, float(sigma_px), 0.0, mask)
        strong = ridge.strength > 0.5 * ridge.strength.max(initial=0.0)
        response.append(float(np.median(ridge.strength[strong])) / np.sqrt(sigma_px) if strong.any() else 0.0)
    return _peak(np.log(_SIGMAS_PX), np.array(response))


def _peak(log_sigma: Array, response: Array) -> float:
    """Sigma of the largest response, through a parabola over its neighbours."""
    best = int(np.clip(np.argmax(response), 1, len(response) - 2))
    below, here, above = response[best - 1 : best + 2]
    bend = below - 2.0 * here + above
    offset = 0.5 * (below - above) / bend if bend < 0.0 else 0.0
    return float(np.exp(log_sigma[best] + np.clip(offset, -1.0, 1.0) * (log_sigma[1] - log_sigma[0])))


def _filters(sigma_px: float) -> Array:
    """The right half (3, r) of the Gaussian and its first two derivatives: taps 0, 1, ... of what is (anti)symmetric.

    Scaled so that 1, x and x^2 / 2 have the derivatives 1, 1 and 1, and a constant has none: sampled and cut off as
    they are, a high black level would shift the ridge.
    """
    x = np.arange(2 * int(np.ceil(_TRUNCATE * sigma_px / 2)) + 1)  # an even number beside the middle
    both = np.where(x > 0, 2.0, 1.0)
    gauss = np.exp(-0.5 * (x / sigma_px) ** 2)
    gauss /= both @ gauss
    slope = x * gauss / (both @ (x**2 * gauss))
    bend = (x**2 - both @ (x**2 * gauss)) * gauss
    return np.stack([gauss, slope, 2.0 * bend / (both @ (x**2 * bend))])


def _span(used: NDArray[np.bool_]) -> slice:
    places = np.flatnonzero(used)
    return slice(int(places[0]), int(places[-1]) + 1)


def _with_margin(values: NDArray[np.generic], rows: slice, columns: slice, margin: int) -> Array:
    """That part of an image with the filter's margin around it; beyond the image's edge its last pixels repeat."""
    row = np.clip(np.arange(rows.start - margin, rows.stop + margin), 0, values.shape[0] - 1)
    column = np.clip(np.arange(columns.start - margin, columns.stop + margin), 0, values.shape[1] - 1)
    inner = values[row[0] : row[-1] + 1, column[0] : column[-1] + 1].astype(np.float64)
    before = [int(np.count_nonzero(place == place[0]) - 1) for place in (row, column)]
    after = [int(np.count_nonzero(place == place[-1]) - 1) for place in (row, column)]
    return np.ascontiguousarray(np.pad(inner, list(zip(before, after, strict=True)), mode="edge"))


@njit(cache=True, parallel=True)
def _ridge_rows(
    image: Array, wanted: NDArray[np.bool_], filters: Array, sigma_px: float, limits: tuple[float, float], found: Array
) -> None:
    """Fill (u, v, strength, rival) per row; strength 0 where nothing exceeds the threshold."""
    height = len(found)
    for part in prange(_PARTS):
        first, last = part * height // _PARTS, (part + 1) * height // _PARTS
        _some_rows(image[first:], wanted[first:last], filters, sigma_px, limits, found[first:last])
        found[first:last, 1] += first


@njit(cache=True)
def _some_rows(
    image: Array, wanted: NDArray[np.bool_], filters: Array, sigma_px: float, limits: tuple[float, float], found: Array
) -> None:
    width, margin = wanted.shape[1], filters.shape[1] - 1
    threshold, apart = limits
    down, field, strength = np.empty((3, image.shape[1])), np.empty((5, width)), np.empty(width)
    for row in range(len(found)):
        found[row] = 0.0
        first, last = _ends(wanted[row])
        if first == last:
            continue
        _derivatives(image[row : row + 2 * margin + 1], first, last, filters, down, field)
        _strengths(field[0], field[1], field[2], strength)
        best = _strongest(field, strength, wanted[row], (first, last), (threshold, sigma_px))
        if best >= 0:
            across, along = _offset(field, best, sigma_px)
            found[row, :3] = best + across, row + along, strength[best]
            left = _strongest(field, strength, wanted[row], (first, int(np.ceil(best - apart))), (threshold, sigma_px))
            right = _strongest(field, strength, wanted[row], (int(best + apart) + 1, last), (threshold, sigma_px))
            for other in (left, right):
                if other >= 0:
                    found[row, 3] = max(found[row, 3], strength[other])


@njit(cache=True)
def _ends(wanted: NDArray[np.bool_]) -> tuple[int, int]:
    """First and last but one of what is wanted of a row."""
    first, last = 0, len(wanted)
    while first < last and not wanted[first]:
        first += 1
    while last > first and not wanted[last - 1]:
        last -= 1
    return first, last


@njit(cache=True, fastmath={"contract", "nsz"})
def _derivatives(image: Array, first: int, last: int, filters: Array, down: Array, field: Array) -> None:
    """Derivatives (uu, vv, uv, u, v) of the filtered image, from `first` to `last` of its middle row.

    The image (2 r + 1, w + 2 r) has the filter's margin around that row.
    """
    # Slices of single rows, not indices: a compiler that minds negative indices or strides does not vectorise.
    smooth, slope, bend = filters
    lines = slice(first, last + 2 * (len(smooth) - 1))
    for order, (taps, sign) in enumerate(((smooth, 1.0), (slope, -1.0), (bend, 1.0))):
        _down(image, lines, taps, sign, down[order][lines])
    here = slice(first, last)
    _along(down[0][lines], bend, 1.0, field[0][here])
    _along(down[2][lines], smooth, 1.0, field[1][here])
    _along(down[1][lines], slope, -1.0, field[2][here])
    _along(down[0][lines], slope, -1.0, field[3][here])
    _along(down[1][lines], smooth, 1.0, field[4][here])


@njit(cache=True, fastmath={"contract", "nsz"})
def _down(image: Array, lines: slice, taps: Array, sign: float, out: Array) -> None:
    """The middle row of an image under a filter down its columns, symmetric (sign 1) or antisymmetric (-1)."""
    middle = len(taps) - 1
    _start(image[middle][lines], taps[0], out)
    for k in range(1, len(taps), 2):
        near = image[middle + k][lines], image[middle - k][lines]
        far = image[middle + k + 1][lines], image[middle - k - 1][lines]
        _add_two(out, sign, (taps[k], taps[k + 1]), near, far)


@njit(cache=True, fastmath={"contract", "nsz"})
def _along(line: Array, taps: Array, sign: float, out: Array) -> None:
    """A line (w + 2 r) under a filter along it, symmetric (sign 1) or antisymmetric (-1)."""
    middle = len(taps) - 1
    _start(line[middle:], taps[0], out)
    for k in range(1, len(taps), 2):
        near, far = (line[middle + k :], line[middle - k :]), (line[middle + k + 1 :], line[middle - k - 1 :])
        _add_two(out, sign, (taps[k], taps[k + 1]), near, far)


@njit(cache=True, fastmath={"contract", "nsz"})
def _start(line: Array, tap: float, out: Array) -> None:
    for j in range(len(out)):
        out[j] = tap * line[j]


@njit(cache=True, fastmath={"contract", "nsz"})
def _add_two(
    out: Array, sign: float, taps: tuple[float, float], near: tuple[Array, Array], far: tuple[Array, Array]
) -> None:
    """Add two pairs of lines, each under its tap: two at a time, since the sums' own traffic is what takes time."""
    for j in range(len(out)):
        out[j] += taps[0] * (near[0][j] + sign * near[1][j]) + taps[1] * (far[0][j] + sign * far[1][j])


@njit(cache=True, fastmath={"contract", "nsz"})
def _strengths(uu: Array, vv: Array, uv: Array, out: Array) -> None:
    """Minus the eigenvalue of largest size of each Hessian; negative for a valley."""
    for j in range(len(out)):
        trace, split = uu[j] + vv[j], uu[j] - vv[j]
        bend = np.sqrt(split * split + 4.0 * uv[j] * uv[j])
        out[j] = -0.5 * (trace + (bend if trace > 0.0 else -bend))


@njit(cache=True)
def _strongest(
    field: Array, strength: Array, wanted: NDArray[np.bool_], span: tuple[int, int], limits: tuple[float, float]
) -> int:
    """Column of the strongest ridge point over `least`; -1 where there is none."""
    best = -1
    least, sigma_px = limits
    for j in range(span[0], span[1]):
        if strength[j] > least and wanted[j]:
            across, along = _offset(field, j, sigma_px)
            if abs(across) <= _OWN_PIXEL and abs(along) <= _OWN_PIXEL:
                best, least = j, strength[j]
    return best


@njit(cache=True)
def _offset(field: Array, j: int, sigma_px: float) -> tuple[float, float]:
    """From the pixel to the ridge, in columns and rows, along the direction of most curvature.

    -slope / curvature is x / (1 - x^2 / S^2) at x from the top of a Gaussian of variance S^2, which is twice the
    filter's where that is matched: solved for x, so that narrow stripes are not pushed away from pixel centres.
    """
    uu, vv, uv = field[0, j], field[1, j], field[2, j]
    bend = np.sqrt((uu - vv) ** 2 + 4.0 * uv * uv)
    curvature = 0.5 * (uu + vv - bend)
    # Of the two forms of the eigenvector the one that does not cancel.
    across, along = (curvature - vv, uv) if uu < vv else (uv, curvature - uu)
    length2 = across * across + along * along
    if length2 == 0.0:
        across, along, length2 = 1.0, 0.0, 1.0
    length = np.sqrt(length2)
    step = -(field[3, j] * across + field[4, j] * along) / (curvature * length)
    step *= 2.0 / (1.0 + np.sqrt(1.0 + 2.0 * (step / sigma_px) ** 2)) / length
    return step * across, step * along
