"""Compiled loops in threads, a part of the elements at a time.

For loops with long bodies: numba's own parallel loops compile and optimise the whole body several times.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numba

Found = TypeVar("Found")


def in_parts(work: Callable[[int, int], Found], count: int, size: int) -> list[Found]:
    """What `work(start, stop)` gives for every `size` of `count` elements; its loops must let go of the lock (`nogil`).

    One part alone is worked on where it is asked for, so that what runs in threads can be made of what would.
    """
    if count <= size:
        return [work(0, count)] if count > 0 else []
    with ThreadPoolExecutor(numba.get_num_threads()) as pool:
        return list(pool.map(lambda start: work(start, min(start + size, count)), range(0, count, size)))
