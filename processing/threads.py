"""Compiled loops in threads, a part of the elements at a time.

For loops with long bodies: numba's own parallel loops compile and optimise the whole body several times.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numba


def in_parts(work: Callable[[int, int], None], count: int, size: int) -> None:
    """Call `work(start, stop)` for every `size` of `count` elements; its loops must let go of the lock (`nogil`)."""
    starts = range(0, count, size)
    with ThreadPoolExecutor(numba.get_num_threads()) as pool:
        for _ in pool.map(lambda start: work(start, min(start + size, count)), starts):
            pass  # raises what a part raised
