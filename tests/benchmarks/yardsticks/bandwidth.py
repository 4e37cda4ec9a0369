"""How fast this machine reads its memory: the floor under every method that must read its input once."""

import time

import numpy as np
from numba import njit, prange

_BYTES = 256 << 20  # well above any cache
_BLOCK = 1 << 16


@njit(parallel=True)
def _sum(words):
    total = np.uint64(0)
    for block in prange(words.size // _BLOCK):
        part = np.uint64(0)
        for i in range(block * _BLOCK, (block + 1) * _BLOCK):
            part += words[i]
        total += part
    return total


def read_bandwidth(repeats=7):
    """Bytes per second that all threads together read from memory, best of `repeats`."""
    words = np.ones(_BYTES // 8, np.uint64)
    assert _sum(words) == words.size
    return _BYTES / fastest(lambda: _sum(words), repeats)


def fastest(call, repeats):
    """Seconds of the fastest of `repeats` calls: what the machine can do, not what else it is doing."""
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - start)
    return min(seconds)
