"""The benchmark of skins tells a line that shows from one that does not."""

import numpy as np
import pytest

from tests.benchmarks.srfs.skins import _Picture


def picture(luminance, chart):
    """A plate that is seen straight on, a pixel apart."""
    rows, columns = np.indices(luminance.shape).astype(float)
    place = np.stack([columns, -rows, np.zeros_like(rows)], axis=-1)
    return _Picture(luminance, place, np.zeros((*luminance.shape, 2)), chart)


@pytest.fixture
def halves():
    return (np.indices((24, 40))[1] >= 20).astype(np.int64)


def test_line_without_a_step_has_contrast_one(halves):
    rows, columns = np.indices((24, 40))
    told = picture(3.0 * columns + rows, halves).contrast(halves)
    assert told["contrast"] == pytest.approx(1.0)
    assert told["pixels"] == 24


def test_step_on_the_line_counts_over_the_gradient_beside_it(halves):
    rows, columns = np.indices((24, 40))
    told = picture(0.5 * (rows + columns) + 3.0 * halves, halves).contrast(halves)
    assert told["contrast"] == pytest.approx(7.0)


def test_pixels_beside_the_body_and_behind_it_do_not_count(halves):
    rows, columns = np.indices((24, 40))
    seen = picture(1.0 * (rows + columns), np.where(columns < 10, -1, halves))
    seen.place[:, 30:, 2] += 100.0
    seen.luminance[:, 30:] += 500.0
    told = seen.contrast(np.where(columns < 30, halves, 2))
    assert told["contrast"] == pytest.approx(1.0)
    assert told["pixels"] == 24
