"""Merging a bracket from those parts of its frames alone that tell something.

A sample of exposure t has the information I = t^2 / (r t + read variance) about the radiance r, none where it is
saturated. To leave out frames of information I_skip beside others of I_read moves the estimate, at random, by
sqrt(I_skip / (I_read + I_skip)) of its own standard deviation: what stays under a stated share need not be read.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import norm

from processing.errors import ImageError
from processing.radiometry.hdr import Radiance, merge_exposures
from processing.radiometry.sensor import PixelCorrection, Sensor
from processing.radiometry.tile_kernel import gather_tiles, scatter_tiles, tile_extremes

Array = NDArray[np.float64]
Tiles = NDArray[np.bool_]
Curve = Callable[[NDArray[np.uint16]], NDArray[np.generic]]
Sample = TypeVar("Sample", bound=np.generic)

SHARE = 0.1  # of its standard deviation by which a result may change: its error grows by half a percent
TILE_PX = 32
PATCH_PX = 64  # of whole tiles
SURVEY = 12  # one patch of so many is decoded in every frame, for what only the comparison of frames shows;
SURVEY_PATCHES = 16, 48  # of small images one of fewer and of large ones one of more, so that there are about so many
_LEVEL_RATIO = 1.1
_MARGIN = 4.0  # standard deviations by which a tile's extremes may be off
_PHI = 0.6180339887  # golden section: spreads the surveyed patches evenly over rows and columns


@dataclass(frozen=True, eq=False)
class ReadReport:
    """Shares of each frame's samples (k,): decoded, skipped as saturated, skipped because other frames tell more."""

    decoded: Array
    saturated: Array
    outweighed: Array

    @property
    def read_ratio(self) -> float:
        """Bytes decoded over the bytes of all frames."""
        return float(self.decoded.mean())


@dataclass(frozen=True, eq=False)
class AdaptiveMerge:
    """The merged image, and what of the frames it was made from."""

    radiance: Radiance
    report: ReadReport


def merge_adaptively(
    frames: Sequence[NDArray[np.uint16]],
    exposure_s: ArrayLike,
    sensor: Sensor,
    correction: PixelCorrection | None = None,
    *,
    linear_dn: Curve = np.asarray,
    share: float = SHARE,
) -> AdaptiveMerge:
    """Merge frames (h, w), touching no tile of one that would change a result by more than `share` of its deviation.

    Within every tile the rms difference to the merge of all samples is under `share` of the standard deviation. A
    first frame, the one that most levels need, gives each tile's range of radiance, with noise margins; frames that
    matter within that range are read, and narrow it. Tiles of the `survey` are read of all frames. Elsewhere frames on
    disk are not touched, but the system reads whole pages. Share 0 leaves out what is saturated beyond doubt alone.
    `linear_dn` makes counts linear.
    Raises ImageError where frames, exposures and correction do not fit together.
    """
    times = np.asarray(exposure_s, np.float64)
    _check(frames, times, share)
    needs = _Needs(times, sensor, share)
    hot = np.zeros((0, 0), np.bool_) if correction is None else correction.hot
    reading = _Reading(frames, times, needs, hot, lambda dn: _bounds(linear_dn(dn), sensor))
    reading.run(survey(frames[0].shape))

    def merge(used: NDArray[np.intp], tiles: _AlikeTiles) -> Radiance:
        stack = np.empty((len(used), *tiles.size), np.uint16)
        for pixels, frame in zip(stack, used, strict=True):
            tiles.gather(frames[frame], pixels)
        return merge_exposures(linear_dn(stack), times[used], sensor, _gathered(correction, tiles))

    return AdaptiveMerge(_merge_tiles(merge, reading.decoded, frames[0].shape), reading.report())


def survey(shape: tuple[int, ...]) -> Tiles:
    """Which tiles (rows, columns) of images (h, w) are decoded in every frame: those of evenly spread patches."""
    rows, columns = (-(-size // TILE_PX) for size in shape)
    tiles_each = PATCH_PX // TILE_PX
    return _picked(shape).repeat(tiles_each, axis=0).repeat(tiles_each, axis=1)[:rows, :columns]


def survey_patches(frames: Sequence[NDArray[np.uint16]]) -> NDArray[np.uint16]:
    """The surveyed patches of all frames, (k, n, h, w); of images without a whole one, the images.

    Raises ImageError where the frames are none or of different sizes.
    """
    _check_sizes(frames)
    corners = PATCH_PX * np.argwhere(_picked(frames[0].shape))
    patches = [(slice(row, row + PATCH_PX), slice(column, column + PATCH_PX)) for row, column in corners]
    whole = [patch for patch in patches if frames[0][patch].shape == (PATCH_PX, PATCH_PX)]
    return np.stack([[frame[patch] for patch in whole or [(slice(None), slice(None))]] for frame in frames])


def _picked(shape: tuple[int, ...]) -> Tiles:
    """Which patches, by row and column of patches, are surveyed."""
    rows, columns = (-(-size // PATCH_PX) for size in shape)
    least, most = SURVEY_PATCHES
    pitch = max(min(rows * columns / least, SURVEY), rows * columns / most, 1.0)
    number = np.arange(rows)[:, None] * _PHI + np.arange(columns) / pitch
    picked = (number + 0.5 / pitch) % 1.0 < 1 / pitch
    picked[rows // 2, columns // 2] = True
    return picked


def tile_slices(tile: tuple[int, int]) -> tuple[slice, slice]:
    """Rows and columns of a tile."""
    row, column = tile[0] * TILE_PX, tile[1] * TILE_PX
    return slice(row, row + TILE_PX), slice(column, column + TILE_PX)


def _check_sizes(frames: Sequence[NDArray[np.generic]]) -> None:
    shapes = {frame.shape for frame in frames}
    if len(shapes) != 1 or len(next(iter(shapes))) != 2:
        raise ImageError(f"frames of {sorted(shapes)}; one or more of equal (h, w) are needed.")


def _check(frames: Sequence[NDArray[np.uint16]], times: Array, share: float) -> None:
    _check_sizes(frames)
    types = {frame.dtype for frame in frames}
    if types != {np.dtype(np.uint16)}:  # others would be cut to it in silence
        raise ImageError(f"frames of {', '.join(sorted(map(str, types)))}; whole counts, uint16, are needed.")
    if times.shape != (len(frames),):
        raise ImageError(f"{len(frames)} frames with {times.size} exposure times; as many are needed.")
    if not (np.isfinite(times) & (times > 0)).all():
        raise ImageError(f"exposure times must be positive and finite, not {times.tolist()} s.")
    if not 0 <= share < 1:
        raise ImageError(f"a share of {share:g}: between 0 (read all) and 1 standard deviation.")


class _Needs:
    """Which frames a range of radiance needs; `shares` (level, k) of the information at rising `levels` (e-/s)."""

    def __init__(self, times: Array, sensor: Sensor, share: float) -> None:
        dark, sharpest = np.sqrt(sensor.dark_variance_e2), 2 * sensor.saturation_e
        bottom, top = 0.01 * dark / times.max(), sharpest / times.min()
        steps = int(np.ceil(np.log(top / bottom) / np.log(_LEVEL_RATIO)))
        self.levels = np.concatenate([[0.0], np.geomspace(bottom, top, steps + 1)])
        information = _information(self.levels, times, sensor)
        # What saturates even the shortest exposure must still be seen to do so.
        shortest = int(times.argmin())
        information[:, shortest] = np.maximum(information[:, shortest], 1e-12 * times[shortest] ** 2)
        self.shares = information / information.sum(axis=1, keepdims=True)
        self.saturated = np.multiply.outer(self.levels, times) > sensor.saturation_e
        self._limit = share**2 / (1 + share**2)  # of the deviation of the whole merge
        self._sets: dict[tuple[int, int], NDArray[np.bool_]] = {}

    @cached_property
    def first(self) -> int:
        """The frame that most levels above the noise need; of equals, the middle one."""
        counts = np.sum([self.frames(i, i) for i in range(len(self.levels))], axis=0)
        best = np.flatnonzero(counts == counts.max())
        return int(best[len(best) // 2])

    def interval(self, low: NDArray[np.floating], high: NDArray[np.floating]) -> tuple[NDArray[np.intp], ...]:
        """Indices of the levels that enclose these ranges."""
        below = np.searchsorted(self.levels, low, side="right") - 1
        above = np.searchsorted(self.levels, high, side="left")
        last = len(self.levels) - 1
        return np.clip(below, 0, last), np.clip(above, 0, last)

    def frames(self, low: int, high: int) -> NDArray[np.bool_]:
        """Which frames (k,) must be read where all levels from `low` to `high` may occur."""
        if (low, high) not in self._sets:
            shares = self.shares[low : high + 1]
            largest = shares.max(axis=0)
            skipped, needed = np.zeros(len(shares)), np.ones(shares.shape[1], np.bool_)
            for frame in np.argsort(largest, kind="stable")[:-1]:
                skipped = skipped + shares[:, frame]
                if skipped.max() > self._limit:
                    break
                needed[frame] = False
            self._sets[low, high] = needed
        return self._sets[low, high]

    def next(self, low: int, high: int, decoded: NDArray[np.bool_]) -> int:
        """The undecoded frame that tells most about these levels, of those that are needed; -1 for none."""
        missing = self.frames(low, high) & ~decoded
        if not missing.any():
            return -1
        return int(np.where(missing, self.shares[low : high + 1].mean(axis=0), -1.0).argmax())


def _information(levels: Array, times: Array, sensor: Sensor) -> Array:
    """Information (level, k) of one sample that is censored at saturation (Tobin 1958)."""
    mean = np.multiply.outer(levels, times)
    variance = mean + sensor.dark_variance_e2
    a = np.clip((sensor.saturation_e - mean) / np.sqrt(variance), -8.0, 8.0)
    factor = norm.cdf(a) - norm.pdf(a) * (a - norm.pdf(a) / norm.sf(a))
    return np.asarray(np.where(a <= -8.0, 0.0, factor) * times**2 / variance, np.float64)


def _bounds(extremes_dn: NDArray[np.generic], sensor: Sensor) -> Array:
    """Range (2, n) of the mean electrons m of samples y: |y - m| <= `_MARGIN` sqrt(m + dark variance)."""
    dn = np.asarray(extremes_dn, np.float64)
    electrons = (np.minimum(dn, sensor.white_dn - 0.5) - sensor.black_dn) * sensor.gain_e_per_dn + _MARGIN**2 / 2
    spread = _MARGIN * np.sqrt(np.maximum(electrons + sensor.dark_variance_e2 - _MARGIN**2 / 4, 0.0))
    bounds = np.maximum(electrons + np.array([[-1.0], [1.0]]) * spread, 0.0)
    bounds[1, dn[1] >= sensor.white_dn] = np.inf
    return np.asarray(bounds, np.float64)


class _Reading:
    """Decides tile by tile which frames are decoded; `decoded` (k, rows, columns of tiles)."""

    def __init__(
        self, frames: Sequence[NDArray[np.uint16]], times: Array, needs: _Needs, hot: Tiles, bounds: Curve
    ) -> None:
        self._frames, self._times, self._needs, self._hot, self._bounds = frames, times, needs, hot, bounds
        self._shape = frames[0].shape
        grid = tuple(-(-size // TILE_PX) for size in self._shape)
        self._low, self._high = np.zeros(grid), np.full(grid, np.inf)
        self.decoded = np.zeros((len(frames), *grid), np.bool_)

    def run(self, surveyed: Tiles) -> None:
        """Read the first frame everywhere, the surveyed tiles of all, and what the ranges then ask for."""
        self._read(self._needs.first, np.argwhere(np.ones_like(surveyed)))
        waiting = np.argwhere(~surveyed)
        while len(waiting):
            wanted = self._wanted(waiting)
            for frame in np.unique(wanted[wanted >= 0]):
                self._read(int(frame), waiting[wanted == frame])
            waiting = waiting[wanted >= 0]
        self.decoded[:, surveyed] = True

    def _wanted(self, tiles: NDArray[np.intp]) -> NDArray[np.intp]:
        """The frame that each tile needs next, -1 for none; tiles in the same state are decided once."""
        y, x = tiles.T
        below, above = self._needs.interval(self._low[y, x], self._high[y, x])
        decoded = self.decoded[:, y, x]
        one_of_each, which = _distinct([below, above, *np.packbits(decoded, axis=0)])
        wanted = [self._needs.next(int(below[i]), int(above[i]), decoded[:, i]) for i in one_of_each]
        return np.array(wanted)[which]

    def _read(self, frame: int, tiles: NDArray[np.intp]) -> None:
        """Touch these tiles of a frame and narrow their ranges."""
        y, x = tiles.T
        extremes = tile_extremes(self._frames[frame], tiles * TILE_PX, TILE_PX, self._hot)
        low, high = self._bounds(extremes) / self._times[frame]
        low, high = np.maximum(self._low[y, x], low), np.minimum(self._high[y, x], high)
        # Where something moved the bounds of two frames may contradict each other: then both are kept.
        self._low[y, x], self._high[y, x] = np.minimum(low, high), np.maximum(low, high)
        self.decoded[frame, y, x] = True

    def report(self) -> ReadReport:
        height, width = self._shape
        rows = np.minimum(TILE_PX, height - TILE_PX * np.arange(self.decoded.shape[1]))
        columns = np.minimum(TILE_PX, width - TILE_PX * np.arange(self.decoded.shape[2]))
        weight = np.multiply.outer(rows, columns) / (height * width)
        saturated = ~self.decoded & np.moveaxis(
            self._needs.saturated[self._needs.interval(self._low, self._high)[0]], -1, 0
        )
        outweighed = ~self.decoded & ~saturated
        return ReadReport(*((one * weight).sum(axis=(1, 2)) for one in (self.decoded, saturated, outweighed)))


@dataclass(frozen=True, eq=False)
class _AlikeTiles:
    """Tiles of one size (rows, columns) with the same frames, by their upper left corners (n, 2)."""

    corners: NDArray[np.intp]
    shape: tuple[int, int]

    @property
    def size(self) -> tuple[int, int]:
        """Shape of an array with a tile's pixels in each row."""
        return len(self.corners), self.shape[0] * self.shape[1]

    def gather(self, image: NDArray[Sample], pixels: NDArray[Sample]) -> NDArray[Sample]:
        """The tiles' pixels, into an array of `size`."""
        gather_tiles(image, self.corners, pixels.reshape(-1, *self.shape))
        return pixels

    def gathered(self, image: NDArray[Sample]) -> NDArray[Sample]:
        """The tiles' pixels in an array of `size`."""
        return self.gather(image, np.empty(self.size, image.dtype))

    def scatter(self, pixels: NDArray[Sample], image: NDArray[Sample]) -> None:
        """The contrary of `gather`."""
        scatter_tiles(pixels.reshape(-1, *self.shape), self.corners, image)


def _merge_tiles(
    merge: Callable[[NDArray[np.intp], _AlikeTiles], Radiance], decoded: Tiles, shape: tuple[int, ...]
) -> Radiance:
    """Merge the tiles that have the same frames in one call each."""
    merged = Radiance(np.empty(shape, np.float32), np.empty(shape, np.float32), np.empty(shape, np.uint8))
    for used, tiles in _alike(decoded, shape):
        part = merge(used, tiles)
        tiles.scatter(part.value, merged.value)
        tiles.scatter(part.variance, merged.variance)
        tiles.scatter(part.status, merged.status)
    return merged


def _alike(decoded: Tiles, shape: tuple[int, ...]) -> Iterator[tuple[NDArray[np.intp], _AlikeTiles]]:
    """Sets of frames with the tiles, of one size, that have them."""
    tiles = np.argwhere(np.ones(decoded.shape[1:], np.bool_))
    corners, sets = tiles * TILE_PX, decoded.reshape(len(decoded), -1)
    height, width = np.minimum(TILE_PX, np.array(shape) - corners).T
    one_of_each, which = _distinct([height, width, *np.packbits(sets, axis=0)])
    for number, i in enumerate(one_of_each):
        yield np.flatnonzero(sets[:, i]), _AlikeTiles(corners[which == number], (int(height[i]), int(width[i])))


def _distinct(columns: Sequence[NDArray[np.integer]]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The place of one of each kind of row, and the kind (n,) of every row; faster than `np.unique` of whole rows."""
    first, kind = np.zeros(1, np.intp), np.zeros(len(columns[0]), np.int64)
    for column in columns:
        _, first, kind = np.unique(kind * (int(column.max()) + 1) + column, return_index=True, return_inverse=True)
    return first, kind


def _gathered(correction: PixelCorrection | None, tiles: _AlikeTiles) -> PixelCorrection | None:
    if correction is None:
        return None
    return PixelCorrection(
        tiles.gathered(correction.offset_dn),
        tiles.gathered(correction.dark_e_s),
        tiles.gathered(correction.flat),
        tiles.gathered(correction.hot),
        None if correction.dark_variance is None else tiles.gathered(correction.dark_variance),
        None if correction.flat_variance is None else tiles.gathered(correction.flat_variance),
    )
