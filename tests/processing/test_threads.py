"""Loops in parts: each element once, errors told. Products of matrices in one thread."""

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from processing.threads import in_parts, products_in_one_thread


@pytest.mark.parametrize("count", [0, 1, 7, 8, 9])
def test_every_element_is_met_once(count):
    met = np.zeros(count, int)

    def part(start, stop):
        assert stop - start <= 4
        met[start:stop] += 1

    in_parts(part, count, 4)
    assert (met == 1).all()


def test_an_error_of_a_part_is_raised():
    def part(start, stop):
        if start == 8:
            raise ValueError("part of 8")

    with pytest.raises(ValueError, match="part of 8"):
        in_parts(part, 20, 4)


def linear_algebra_threads() -> list[int]:
    return [one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"]


def test_products_are_in_one_thread_as_long_as_it_is_asked_for():
    before = linear_algebra_threads()
    with products_in_one_thread():
        assert linear_algebra_threads() == [1] * len(before)
    assert linear_algebra_threads() == before
