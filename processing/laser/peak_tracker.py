"""The brightest moment of every pixel and the samples around it, in one pass over frames as they arrive."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.laser.ambient import sampled_pixels
from processing.laser.block_maxima import STATE, TILE, WINDOW, maxima, scan_chunk
from processing.laser.pulse import UNWANTED, Sweep, first_frames, first_of_window

CHUNK_LIMIT = 32768  # frames of an array that are scanned in one call
_RING = 2 * WINDOW  # frames that a stream remembers: windows are copied out after every WINDOW of them

Times = Sequence[float] | NDArray[np.floating]


@dataclass(frozen=True)
class Profiles:
    """What is kept of a sweep of n frames: per pixel (row-major, h w of them) the samples around its brightest moment.

    `frames_dn[f - origin[pixel], pixel]` is the sample of frame f, for the frames of the pixel's window: the brightest
    block of four and three on either side. Of an array that is the array itself. `brightest` is -1 where a pixel never
    rose above zero, UNWANTED outside the mask. `maxima_dn` (3, pixels) are the highest samples of all, of those outside
    the window, and of those outside the blocks beside the brightest; `total_dn` is the sum over all frames. `times`
    (n,) are in frame intervals; `sample_dn` (n, k) follows some pixels through all of the sweep.
    """

    shape: tuple[int, int]
    times: NDArray[np.float64]
    sample_dn: NDArray[np.uint16]
    frames_dn: NDArray[np.uint16]
    origin: NDArray[np.int32]
    brightest: NDArray[np.int32]
    maxima_dn: NDArray[np.uint16]
    total_dn: NDArray[np.uint64]

    def sweep(self, ambient: NDArray[np.float32]) -> Sweep:
        """The arguments of the fits; `ambient` (n,) is the light's relative change, or empty where it is steady."""
        return self.frames_dn, self.origin, self.brightest, self.maxima_dn, self.total_dn, ambient, self.times

    def subset(self, pixels: NDArray[np.intp]) -> "Profiles":
        """The profiles of some pixels (k,) that have a brightest frame, as of an image (1, k)."""
        origin = first_frames(self.brightest[pixels])
        frame = np.clip(origin + np.arange(WINDOW)[:, None], 0, self.times.size - 1)
        return Profiles(
            (1, pixels.size),
            self.times,
            self.sample_dn,
            self.frames_dn[frame - self.origin[pixels], pixels],
            origin,
            self.brightest[pixels],
            self.maxima_dn[:, pixels],
            self.total_dn[pixels],
        )


class PeakTracker:
    """Follows the brightest moment of every pixel; memory is constant per pixel, whatever the number of frames
    (some hundred bytes of each remain, which tell how the ambient light moved).

    Of equal samples (saturation) the first counts. `mask` (h, w) says which pixels are wanted.
    Raises ImageError where the mask's shape is not (h, w).
    """

    def __init__(self, shape: tuple[int, int], mask: NDArray[np.bool_] | None = None) -> None:
        pixels = shape[0] * shape[1]
        self._scan = _Scan(shape, mask)
        self._shape, self._count = shape, 0
        self._ring = np.zeros((_RING, pixels), np.uint16)
        self._window = np.zeros((WINDOW, pixels), np.uint16)
        self._sampled = sampled_pixels(pixels)
        self._sample: list[NDArray[np.uint16]] = []

    def add(self, frame_dn: NDArray[np.uint16]) -> None:
        """Take the next frame (h, w). Raises ImageError where its shape or type differs from the first one's."""
        frame = np.asarray(frame_dn)
        if frame.shape != self._shape or frame.dtype != np.uint16:
            raise ImageError(
                f"frame {self._count}: {frame.dtype} {frame.shape} where uint16 {self._shape} is expected; "
                "all frames of a sweep must come from one camera in one format."
            )
        flat = self._ring[self._count % _RING]
        flat[:] = frame.reshape(-1)
        self._sample.append(flat[self._sampled])
        self._count += 1
        if self._count % WINDOW == 0:
            self._take(WINDOW)

    def profiles(self, times: Times | None = None) -> Profiles:
        """End the sweep. `times` (n,) in frame intervals says when each frame was taken: 0, 1, 2, ... if omitted.

        Raises ImageError where there was no frame, or the times do not rise or are not one per frame.
        """
        taken = _checked_times(times, self._count)
        rest = self._count % WINDOW
        if rest:
            self._take(rest)
        brightest = self._scan.brightest
        _copy_windows(self._ring, brightest, (self._count - rest, self._count + WINDOW), self._window)
        origin = first_frames(brightest)
        return self._scan.profiles(taken, np.stack(self._sample), self._window, origin)

    def _take(self, frames: int) -> None:
        """Scan the last `frames` frames, and copy the windows which are complete since the last time."""
        first = self._count - frames
        self._scan.add(self._ring[first % _RING : first % _RING + frames], first)
        _copy_windows(self._ring, self._scan.brightest, (first, self._count), self._window)


class _Scan:
    """Brightest frames, far maxima and sums of the pixels of all frames so far."""

    def __init__(self, shape: tuple[int, int], mask: NDArray[np.bool_] | None) -> None:
        pixels = shape[0] * shape[1]
        tiles = -(-pixels // TILE)
        if mask is not None and mask.shape != shape:
            raise ImageError(f"a mask of {mask.shape} for frames of {shape} pixels.")
        self._shape = shape
        self._mask = None if mask is None else mask.reshape(-1)
        self._wanted = np.ones(tiles, bool)
        if self._mask is not None:
            self._wanted = np.add.reduceat(self._mask, np.arange(tiles) * TILE, dtype=np.int64) > 0
        self._state = np.zeros((tiles, STATE * TILE), np.uint16)
        self._total = np.zeros(pixels, np.uint64)
        self.brightest = np.full(pixels, -1, np.int32)

    def add(self, frames: NDArray[np.uint16], first: int) -> None:
        scan_chunk(frames, first, self._wanted, self._state, self._total, self.brightest)

    def profiles(
        self,
        times: NDArray[np.float64],
        sample_dn: NDArray[np.uint16],
        frames_dn: NDArray[np.uint16],
        origin: NDArray[np.int32],
    ) -> Profiles:
        if self._mask is not None:
            self.brightest[~self._mask] = UNWANTED
        highest = maxima(self._state, self.brightest.size)
        return Profiles(self._shape, times, sample_dn, frames_dn, origin, self.brightest, highest, self._total)


def track_peaks(
    frames: Iterable[NDArray[np.uint16]], times: Times | None = None, mask: NDArray[np.bool_] | None = None
) -> Profiles:
    """Profiles of a sweep given as an array (t, h, w) or as any iterable of frames (h, w), uint16 raw_dn.

    Frames at equal `times` are one frame that was recorded twice and count once.
    Raises ImageError where there is no frame, where one (or the mask) differs in shape or type, where times fall, or
    where frames at one time differ.
    """
    moments = None if times is None else np.asarray(times, np.float64)
    twice = moments is not None and bool(np.any(np.diff(moments) == 0))
    if isinstance(frames, np.ndarray) and frames.dtype == np.uint16 and frames.ndim == 3 and len(frames) and not twice:
        return _track_array(np.ascontiguousarray(frames), moments, mask)
    if twice and moments is not None:
        frames, moments = _without_doubles(frames, moments), np.unique(moments)
    tracker: PeakTracker | None = None
    for frame in frames:
        if tracker is None:
            if np.ndim(frame) != 2:
                raise ImageError(f"a frame of a sweep is a mosaic (h, w), not an array of shape {np.shape(frame)}.")
            tracker = PeakTracker(frame.shape, mask)
        tracker.add(frame)
    if tracker is None:
        raise ImageError("a sweep without frames: nothing was recorded.")
    return tracker.profiles(moments)


def _track_array(
    frames: NDArray[np.uint16], times: NDArray[np.float64] | None, mask: NDArray[np.bool_] | None
) -> Profiles:
    taken = _checked_times(times, len(frames))
    flat = frames.reshape(len(frames), -1)
    scan = _Scan((frames.shape[1], frames.shape[2]), mask)
    for first in range(0, len(flat), CHUNK_LIMIT):
        scan.add(flat[first : first + CHUNK_LIMIT], first)
    return scan.profiles(taken, flat[:, sampled_pixels(flat.shape[1])], flat, np.zeros(flat.shape[1], np.int32))


def _checked_times(times: Times | None, count: int) -> NDArray[np.float64]:
    taken = np.arange(count, dtype=np.float64) if times is None else np.asarray(times, np.float64)
    if count == 0:
        raise ImageError("a sweep without frames: nothing was recorded.")
    if taken.shape != (count,) or not np.all(np.diff(taken) > 0):
        raise ImageError(f"{count} frames need as many rising times, not {taken.shape} values.")
    return taken


def _without_doubles(frames: Iterable[NDArray[np.uint16]], times: NDArray[np.float64]) -> Iterator[NDArray[np.uint16]]:
    """The frames, one per time. Raises ImageError where there are not as many as times or two of one time differ."""
    before: NDArray[np.uint16] | None = None
    for number, (frame, same) in enumerate(zip(frames, np.diff(times, prepend=times[0] - 1.0) == 0, strict=True)):
        if not same:
            yield frame
        elif before is None or not np.array_equal(frame, before):
            raise ImageError(f"frames {number - 1} and {number} differ, but both were taken at {times[number]}.")
        before = frame


@njit(nogil=True, cache=True)
def _copy_windows(
    ring: NDArray[np.uint16], brightest: NDArray[np.int32], ended: tuple[int, int], window: NDArray[np.uint16]
) -> None:
    """Copy out the windows of pixels whose last frame lies in (ended[0], ended[1]], as far as there are frames."""
    for pixel in range(brightest.size):
        start = first_of_window(brightest[pixel])
        if brightest[pixel] >= 0 and ended[0] < start + WINDOW <= ended[1]:
            for j in range(max(-start, 0), WINDOW):
                window[j, pixel] = ring[(start + j) % ring.shape[0], pixel]
