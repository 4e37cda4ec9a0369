"""The repeats of one exposure: their mean per pixel and their noise, each frame read once."""

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.errors import CalibrationError, ImageError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

PHASES = ((0, 0), (0, 1), (1, 0), (1, 1))  # of a mosaic's 2 x 2 cell: row, column
SMALLEST_PX = 8
UNSATURATED = 0.01  # share below the highest code from which equal frames are copies, not saturated


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame: counts (h, w), and when it was taken."""

    raw_dn: NDArray[np.generic]
    taken_s: float


@dataclass(frozen=True, eq=False)
class Series:
    """What the frames of one exposure say together.

    Per pixel (h, w): the mean, and `scatter_dn2`, the sum of squares about it. `frame_dn` (n, 4) is the level of each
    frame in each phase of the mosaic, which is taken out of the scatter; `taken_s` (n,) when each was taken.
    """

    exposure_s: float
    mean_dn: Array
    scatter_dn2: Array
    frame_dn: Array
    taken_s: Array

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.taken_s)


@dataclass(frozen=True, eq=False)
class Levels:
    """A series per phase of the mosaic (4,), over the pixels that count.

    `level_dn` is the mean with its variance, `variance_dn2` the temporal variance of a sample with `freedom` degrees,
    `brightest_dn` the highest mean of a pixel, `flicker` the relative variance of the light between the frames.
    """

    exposure_s: float
    frames: int
    level_dn: Array
    level_variance_dn2: Array
    variance_dn2: Array
    freedom: Array
    brightest_dn: Array
    flicker: Array


def gather(frames: Iterable[Frame], exposure_s: float) -> Series:
    """Mean and scatter of the frames of one exposure, from running sums.

    A frame equal to another, bit for bit, is the same frame and counts once.
    Raises ImageError where a frame is not finite or of another size, CalibrationError where fewer than two differ.
    """
    sums = _Sums()
    for frame in frames:
        sums.add(frame)
    if len(sums.taken_s) < 2:
        raise CalibrationError(
            f"{len(sums.taken_s)} frame of {exposure_s:g} s; noise shows in two or more that differ."
        )
    return sums.series(exposure_s)


class _Sums:
    """Sums of each frame less its own level, so that flicker of the light is no noise of the pixels."""

    def __init__(self) -> None:
        self._seen: set[bytes] = set()
        self._total: Array = np.zeros((0, 0))
        self._squares: Array = np.zeros((0, 0))
        self._levels: list[Array] = []
        self.taken_s: list[float] = []

    def add(self, frame: Frame) -> None:
        counts = np.ascontiguousarray(frame.raw_dn)
        digest = hashlib.sha256(counts.tobytes()).digest()
        if digest in self._seen and np.mean(counts < counts.max()) > UNSATURATED:
            return
        self._seen.add(digest)
        self._check(counts)
        if not self.taken_s:
            self._total, self._squares = np.zeros(counts.shape), np.zeros(counts.shape)
        level = np.empty(4)
        for phase, (row, column) in enumerate(PHASES):
            part = np.s_[row::2, column::2]
            values = counts[part].astype(np.float64)
            level[phase] = values.mean()
            values -= level[phase]
            self._total[part] += values
            values *= values
            self._squares[part] += values
        self._levels.append(level)
        self.taken_s.append(frame.taken_s)

    def series(self, exposure_s: float) -> Series:
        count, levels = len(self.taken_s), np.stack(self._levels)
        mean = self._total / count
        scatter = np.maximum(self._squares - self._total * mean, 0.0)
        mean += tiled(levels.mean(axis=0), mean.shape)
        return Series(exposure_s, mean, scatter, levels, np.array(self.taken_s))

    def _check(self, values: NDArray[np.generic]) -> None:
        if values.ndim != 2 or min(values.shape) < SMALLEST_PX:
            raise ImageError(
                f"a frame of shape {values.shape}; a mosaic (h, w) of {SMALLEST_PX} pixels or more needed."
            )
        if self.taken_s and values.shape != self._total.shape:
            raise ImageError(f"frames of {self._total.shape} and {values.shape} pixels in one series.")
        if not np.all(np.isfinite(values)):
            raise ImageError(f"frame {len(self.taken_s) + 1} of a series holds values that are not finite.")


def levels(series: Series, counted: Mask) -> Levels:
    """The series per phase, over the pixels `counted` (h, w).

    Every pixel's own mean and every frame's own level are out of the variance. What the light's flicker makes of the
    pixels' own differences (y = g x with g from frame to frame) is subtracted.
    """
    samples = phase_sum(counted)
    level = phase_sum(np.where(counted, series.mean_dn, 0.0)) / np.maximum(samples, 1)
    freedom = np.maximum(samples - 1, 1) * (series.frames - 1)
    variance = phase_sum(np.where(counted, series.scatter_dn2, 0.0)) / freedom
    uneven = phase_sum(np.where(counted, (series.mean_dn - tiled(level, counted.shape)) ** 2, 0.0))
    uneven = np.maximum(uneven / np.maximum(samples, 1) - variance / series.frames, 0.0)
    of_all = series.frame_dn.mean(axis=0)
    spread = series.frame_dn.var(axis=0, ddof=1) - variance / np.maximum(samples, 1)
    flicker = np.maximum(spread, 0.0) / np.where(of_all == 0, 1.0, of_all) ** 2
    bright = np.array([_highest(series.mean_dn[r::2, c::2], counted[r::2, c::2]) for r, c in PHASES])
    level_variance = variance / (np.maximum(samples, 1) * series.frames)
    return Levels(
        series.exposure_s, series.frames, level, level_variance, variance - flicker * uneven, freedom, bright, flicker
    )


def _highest(values: Array, counted: Mask) -> float:
    return float(values[counted].max()) if counted.any() else float("nan")


def phase_sum(values: NDArray[np.generic]) -> Array:
    """Sums (4,) over each phase of a mosaic (h, w)."""
    return np.array([values[row::2, column::2].sum(dtype=np.float64) for row, column in PHASES])


def tiled(per_phase: Array, shape: tuple[int, ...]) -> Array:
    """A mosaic (h, w) of one value (4,) per phase."""
    out = np.empty(shape)
    for value, (row, column) in zip(per_phase, PHASES, strict=True):
        out[row::2, column::2] = value
    return out
