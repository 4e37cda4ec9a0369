"""Compiled loops in threads, a part of the elements at a time; and products of matrices in one thread.

For loops with long bodies: numba's own parallel loops compile and optimise the whole body several times.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from functools import lru_cache
from typing import TypeVar

import numba
from threadpoolctl import ThreadpoolController

Found = TypeVar("Found")


def in_parts(work: Callable[[int, int], Found], count: int, size: int) -> list[Found]:
    """What `work(start, stop)` gives for every `size` of `count` elements; its loops must let go of the lock (`nogil`).

    One part alone is worked on where it is asked for, so that what runs in threads can be made of what would.
    """
    if count <= size:
        return [work(0, count)] if count > 0 else []
    with ThreadPoolExecutor(numba.get_num_threads()) as pool:
        return list(pool.map(lambda start: work(start, min(start + size, count)), range(0, count, size)))


def products_in_one_thread() -> AbstractContextManager[object]:
    """While it holds, the linear algebra library starts no threads of its own in this process.

    Of narrow matrices they gain nothing, and wait busily where another thread has the core.
    """
    limited: AbstractContextManager[object] = _libraries().limit(limits=1, user_api="blas")
    return limited


@lru_cache(maxsize=1)
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()
