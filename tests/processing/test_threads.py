"""Loops in parts: each element once, errors told."""

import numpy as np
import pytest

from processing.threads import in_parts


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
