"""Shifts between photographs of a bracket."""

import cv2
import numpy as np
import pytest

from processing.radiometry.alignment import ShiftStatus
from processing.radiometry.photograph_shift import photograph_shift
from processing.radiometry.response import Response
from simulators.picture import log_exposure
from tests.processing.radiometry.pictures import bracket, camera, scene


def response():
    truth, plain = log_exposure("srgb"), np.ones((256, 3))
    truth[0] = truth[1] - 1
    return Response(truth, 0.01 * plain, plain, plain[0])


def pictures(shift_px, shape=(200, 300)):
    """Two exposures of one scene, the second moved."""
    radiance = scene(0, shape)
    places = np.array([[1, 0, shift_px[0]], [0, 1, shift_px[1]]], float)
    moved = cv2.warpAffine(radiance, places, shape[::-1], borderMode=cv2.BORDER_REFLECT)
    return np.concatenate([bracket(camera(), radiance, [1.0]), bracket(camera(), moved, [4.0], seed=1)])


@pytest.mark.parametrize("shift_px", [(0.0, 0.0), (0.3, 0.0), (0.6, -0.4), (2.0, 1.0)])
def test_shifts_are_found_through_jpeg_at_four_times_the_exposure(shift_px):
    found = photograph_shift(pictures(shift_px), response(), (0, 1))
    np.testing.assert_allclose(found.shift_px, shift_px, atol=0.1)
    assert found.refused == (np.hypot(*shift_px) > 0.5)
    assert (found.status == ShiftStatus.SHIFTED) == any(shift_px)


def test_a_plain_wall_tells_nothing():
    wall = np.full((2, 200, 300, 3), 100, np.uint8)
    assert photograph_shift(wall, response(), (0, 1)).status == ShiftStatus.UNDETERMINED
