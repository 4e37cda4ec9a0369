"""The brightest moment of every pixel and the samples around it, in one pass over frames as they arrive."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.laser.pulse import UNWANTED

REACH = 12  # frames kept on either side of the brightest one: 4 sigma of the widest stripe that is expected


@dataclass(frozen=True)
class Profiles:
    """What is kept of a sweep of n frames: per pixel (row-major, h w of them) the samples around its brightest moment.

    `window_dn[pixel, j]` is the sample of frame `brightest[pixel] - reach + j`, to be used only where that frame
    exists; `brightest` is -1 where a pixel never rose above zero, UNWANTED outside the mask. `second_dn` is the highest
    other local maximum more than `reach` frames away, `total_dn` the sum over all frames, `times` (n,) the frames'
    times in frame intervals.
    """

    shape: tuple[int, int]
    times: NDArray[np.float64]
    window_dn: NDArray[np.uint16]
    brightest: NDArray[np.int32]
    second_dn: NDArray[np.uint16]
    total_dn: NDArray[np.uint64]

    @property
    def reach(self) -> int:
        """Frames on either side of the brightest one."""
        return int(self.window_dn.shape[1]) // 2


class PeakTracker:
    """Follows the brightest moment of every pixel; memory is constant per pixel, whatever the number of frames.

    A frame is judged when `reach` later ones are known: it is a pixel's peak if it exceeds all before it and no
    sample within reach exceeds it. Of equal samples (saturation) the first counts.
    """

    def __init__(self, shape: tuple[int, int], reach: int = REACH) -> None:
        pixels = shape[0] * shape[1]
        self._shape, self._reach, self._count = shape, reach, 0
        self._ring = np.zeros((2 * reach + 1, pixels), np.uint16)
        self._best = np.zeros(pixels, np.uint16)
        self._second = np.zeros(pixels, np.uint16)
        self._brightest = np.full(pixels, -1, np.int32)
        self._window = np.zeros((pixels, 2 * reach + 1), np.uint16)
        self._total = np.zeros(pixels, np.uint64)

    def add(self, frame_dn: NDArray[np.uint16]) -> None:
        """Take the next frame (h, w). Raises ImageError where its shape or type differs from the first one's."""
        frame = np.asarray(frame_dn)
        if frame.shape != self._shape or frame.dtype != np.uint16:
            raise ImageError(
                f"frame {self._count}: {frame.dtype} {frame.shape} where uint16 {self._shape} is expected; "
                "all frames of a sweep must come from one camera in one format."
            )
        flat = np.ascontiguousarray(frame).reshape(-1)
        self._ring[self._count % len(self._ring)] = flat
        self._total += flat
        self._count += 1
        if self._count > self._reach:
            self._judge(self._count - 1 - self._reach)

    def keep(self, mask: NDArray[np.bool_]) -> None:
        """Judge only the pixels of `mask` (h, w) from here on. Raises ImageError where its shape is not the frames'."""
        if mask.shape != self._shape:
            raise ImageError(f"a mask of {mask.shape} for frames of {self._shape} pixels.")
        unwanted = ~mask.reshape(-1)
        self._brightest[unwanted] = UNWANTED
        self._second[unwanted] = np.iinfo(np.uint16).max

    def profiles(self, times: Sequence[float] | NDArray[np.floating] | None = None) -> Profiles:
        """End the sweep. `times` (n,) in frame intervals says when each frame was taken: 0, 1, 2, ... if omitted.

        Raises ImageError where there was no frame, or the times do not rise or are not one per frame.
        """
        for frame in range(max(self._count - self._reach, 0), self._count):
            self._judge(frame)
        taken = np.arange(self._count, dtype=np.float64) if times is None else np.asarray(times, np.float64)
        if self._count == 0:
            raise ImageError("a sweep without frames: nothing was recorded.")
        if taken.shape != (self._count,) or not np.all(np.diff(taken) > 0):
            raise ImageError(f"{self._count} frames need as many rising times, not {taken.shape} values.")
        return Profiles(self._shape, taken, self._window, self._brightest, self._second, self._total)

    def _judge(self, frame: int) -> None:
        last = min(frame + self._reach, self._count - 1)
        span = (max(frame - self._reach, 0), frame, last)
        _judge(self._ring, span, self._best, self._second, self._brightest, self._window)


def track_peaks(
    frames: Iterable[NDArray[np.uint16]],
    times: Sequence[float] | NDArray[np.floating] | None = None,
    mask: NDArray[np.bool_] | None = None,
) -> Profiles:
    """Profiles of a sweep given as an array (t, h, w) or as any iterable of frames (h, w), uint16 raw_dn.

    Raises ImageError where there is no frame, or where one differs in shape or type.
    """
    tracker: PeakTracker | None = None
    for frame in frames:
        if tracker is None:
            if np.ndim(frame) != 2:
                raise ImageError(f"a frame of a sweep is a mosaic (h, w), not an array of shape {np.shape(frame)}.")
            tracker = PeakTracker(frame.shape)
            if mask is not None:
                tracker.keep(mask)
        tracker.add(frame)
    if tracker is None:
        raise ImageError("a sweep without frames: nothing was recorded.")
    return tracker.profiles(times)


@njit(nogil=True, cache=True)
def _judge(
    ring: NDArray[np.uint16],
    span: tuple[int, int, int],
    best: NDArray[np.uint16],
    second: NDArray[np.uint16],
    brightest: NDArray[np.int32],
    window: NDArray[np.uint16],
) -> None:
    first, frame, last = span
    length = ring.shape[0]
    reach = length // 2
    sample = ring[frame % length]
    for pixel in range(sample.size):
        value = sample[pixel]
        if value <= second[pixel] or not _is_peak(ring, first, frame, last, pixel):
            continue
        if value <= best[pixel]:
            second[pixel] = value
            continue
        second[pixel] = best[pixel]
        best[pixel] = value
        brightest[pixel] = frame
        for other in range(first, last + 1):
            window[pixel, other - frame + reach] = ring[other % length, pixel]


@njit(nogil=True, cache=True)
def _is_peak(ring: NDArray[np.uint16], first: int, frame: int, last: int, pixel: int) -> bool:
    length = ring.shape[0]
    value = ring[frame % length, pixel]
    for other in range(frame + 1, last + 1):
        if ring[other % length, pixel] > value:
            return False
    for other in range(frame - 1, first - 1, -1):
        if ring[other % length, pixel] >= value:
            return False
    return True
