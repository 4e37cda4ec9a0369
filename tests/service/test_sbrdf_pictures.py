"""The colours of shifts."""

import numpy as np
import pytest

from service.sbrdf_pictures import shift_colours, shift_scale


def field(length):
    """Shifts of one length, a quarter of them right, down, left and up each."""
    ways = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]], np.float32)
    return length * np.tile(ways, (16, 4, 1))


@pytest.mark.parametrize("outlier", [0.0, 30.0, 1e6])
def test_one_point_does_not_fade_the_others(outlier):
    shift, hidden = field(4.0), np.zeros((16, 16), bool)
    shift[5, 5] = outlier
    assert shift_scale(shift, hidden) == pytest.approx(4.0)


def test_hidden_points_have_no_part_in_the_scale():
    shift, hidden = field(3.0), np.zeros((16, 16), bool)
    shift[:8], hidden[:8] = 100.0, True
    assert shift_scale(shift, hidden) == pytest.approx(3.0)
    assert shift_scale(shift, np.ones_like(hidden)) == 1.0
    assert shift_scale(0 * shift, hidden) == 1.0


def test_red_is_right_and_green_is_up_and_hidden_is_black():
    hidden = np.zeros((16, 16), bool)
    hidden[0, 0] = True
    colours = shift_colours(field(2.0), hidden, 2.0)
    right, down, left, up = colours[1, :4]
    assert (colours[0, 0] == 0).all()
    assert right.argmax() == 0
    assert right.tolist() == [1, 0, 0]
    assert up.argmax() == 1
    assert down.argmax() == 2
    assert left.argmin() == 0
    assert np.ptp(shift_colours(0 * field(2.0), hidden, 2.0)[1:]) == 0  # standing still is white
