"""The brightest frame of every pixel and the brightest sample far from it: one pass of vectorised loops over tiles.

Frames are judged in blocks of four. A pixel's window is its brightest block and three on either side; the highest
sample outside it is followed too, so that every sample of a sweep is in one or the other. The same is followed outside
the brightest block and one on either side, for narrow pulses that are judged by a shorter window.
"""

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

BLOCK = 4  # frames that are compared at once
_KEPT = 4  # block maxima in _RING, those of the last AROUND + 1 blocks
AROUND = 3  # blocks kept on either side of the brightest: 3 sigma and more of the widest stripe that is expected
WINDOW = BLOCK * (2 * AROUND + 1)
TILE = 4096  # pixels whose state stays in a core's cache
STATE = 10  # rows of TILE counts that a tile carries from chunk to chunk
CHUNK_LIMIT = 32768  # frames of one call; numbers within it fit 16 bits

BESIDE = 1  # blocks on either side of the brightest that a short window keeps
_MOST, _INDEX, _FAR, _NEAR, _LAG, _NEAR_LAG, _RING = range(0, 7 * TILE, TILE)
_OFFSET = 32  # number of a chunk's first frame in _INDEX; lower ones belong to earlier chunks, 0 to long ago

Counts = NDArray[np.uint16]


@njit(parallel=True, cache=True)
def scan_chunk(
    frames: Counts,
    first: int,
    wanted: NDArray[np.bool_],
    state: Counts,
    total: NDArray[np.uint64],
    brightest: NDArray[np.int32],
) -> None:
    """Take the next frames (t, pixels) of a sweep into the state of its tiles (tiles, STATE * TILE).

    `first` is the number of the first of them, a multiple of BLOCK, and t too unless it is the sweep's last chunk.
    `wanted` (tiles,) says which tiles to look at. `total` (pixels,) sums all frames, `brightest` int32 (pixels,) is the
    number of the brightest one, the first of equals.
    """
    pixels = frames.shape[1]
    for tile in prange(wanted.size):
        if wanted[tile]:
            low, high = tile * TILE, min((tile + 1) * TILE, pixels)
            _scan_tile(frames, first, (low, high), state[tile], total[low:high], brightest[low:high])


@njit(nogil=True, cache=True)
def _scan_tile(
    frames: Counts,
    first: int,
    span: tuple[int, int],
    work: Counts,
    total: NDArray[np.uint64],
    brightest: NDArray[np.int32],
) -> None:
    low, high = span
    whole = frames.shape[0] // BLOCK
    sums = np.zeros(TILE, np.uint32)
    for block in range(whole):
        row = BLOCK * block
        _judge_block(frames, (row, low, high), row + _OFFSET, _rings(work, first + row), work)
        _add_block(frames, (row, low, high), sums)
    if whole * BLOCK < frames.shape[0]:
        last = np.zeros((BLOCK, high - low), np.uint16)
        last[: frames.shape[0] - whole * BLOCK] = frames[whole * BLOCK :, low:high]
        row = BLOCK * whole
        _judge_block(last, (0, 0, high - low), row + _OFFSET, _rings(work, first + row), work)
        _add_block(last, (0, 0, high - low), sums)
    _close_chunk(work, frames.shape[0], first, sums, total, brightest)


@njit(nogil=True, cache=True)
def _rings(work: Counts, frame: int) -> tuple[Counts, Counts]:
    """Rows of block maxima: of this frame's block, which takes the place of the fourth before it; of two before."""
    here = _RING + frame // BLOCK % _KEPT * TILE
    before = _RING + (frame // BLOCK + _KEPT - BESIDE - 1) % _KEPT * TILE
    return work[here : here + TILE], work[before : before + TILE]


@njit(nogil=True, cache=True)
def _judge_block(
    frames: Counts, part: tuple[int, int, int], number: int, rings: tuple[Counts, Counts], work: Counts
) -> None:
    """Maximum of four frames, its index, and what becomes of the pixel's maximum and the highest ones far from it."""
    row, low, high = part
    a, b, c, d = frames[row, low:high], frames[row + 1, low:high], frames[row + 2, low:high], frames[row + 3, low:high]
    ring, beside = rings
    number16 = np.uint16(number)
    window, short = np.uint16(number - AROUND * BLOCK), np.uint16(number - BESIDE * BLOCK)
    none, one, two, three = np.uint16(0), np.uint16(1), np.uint16(2), np.uint16(3)
    for p in range(a.size):
        most, index = a[p], none
        later, later_index = c[p], two
        if b[p] > most:
            most, index = b[p], one
        if d[p] > later:
            later, later_index = d[p], three
        if later > most:
            most, index = later, later_index
        lag, near_lag = work[_LAG + p], work[_NEAR_LAG + p]  # maxima before the window that this block would have
        lag = ring[p] if ring[p] > lag else lag
        near_lag = beside[p] if beside[p] > near_lag else near_lag
        ring[p], work[_LAG + p], work[_NEAR_LAG + p] = most, lag, near_lag
        known = work[_INDEX + p]
        new = most > work[_MOST + p]
        work[_FAR + p] = _followed(work[_FAR + p], most if known < window else none, lag, new)
        work[_NEAR + p] = _followed(work[_NEAR + p], most if known < short else none, near_lag, new)
        work[_INDEX + p] = number16 + index if new else known
        work[_MOST + p] = most if new else work[_MOST + p]


@njit(nogil=True, cache=True, inline="always")
def _followed(highest: np.uint16, here: np.uint16, before: np.uint16, new: bool) -> np.uint16:
    """The highest sample outside a window that stays where it is, or moves here."""
    highest = here if here > highest else highest
    return before if new else highest


@njit(nogil=True, cache=True)
def _add_block(frames: Counts, part: tuple[int, int, int], sums: NDArray[np.uint32]) -> None:
    row, low, high = part
    a, b, c, d = frames[row, low:high], frames[row + 1, low:high], frames[row + 2, low:high], frames[row + 3, low:high]
    for p in range(a.size):
        sums[p] += np.uint32(a[p]) + np.uint32(b[p]) + np.uint32(c[p]) + np.uint32(d[p])


@njit(nogil=True, cache=True)
def _close_chunk(
    work: Counts,
    frames: int,
    first: int,
    sums: NDArray[np.uint32],
    total: NDArray[np.uint64],
    brightest: NDArray[np.int32],
) -> None:
    for p in range(total.size):
        total[p] += sums[p]
        index = np.int64(work[_INDEX + p])
        if index >= _OFFSET:
            brightest[p] = first + index - _OFFSET
        work[_INDEX + p] = index - frames if index > frames else 0


def maxima(state: Counts, pixels: int) -> Counts:
    """Highest samples (3, pixels): of all, of those outside each pixel's window, of those outside its short one."""
    return np.stack([state[:, row : row + TILE].reshape(-1)[:pixels] for row in (_MOST, _FAR, _NEAR)])
