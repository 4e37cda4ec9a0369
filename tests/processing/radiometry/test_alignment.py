"""Whether exposures show the same picture."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import fourier_shift, gaussian_filter
from scipy.stats import kstest

from processing.errors import ImageError
from processing.radiometry.adaptive import survey_patches
from processing.radiometry.alignment import ShiftStatus, alignment, shift_error
from tests.processing.radiometry.test_hdr import EXPOSURE_S, SENSOR, photograph

SHAPE = (256, 320)
quick = settings(max_examples=10, deadline=None)


def scene(kind, seed=0):
    """Radiance images (h, w) with more or less of an edge in them."""
    rng = np.random.default_rng(seed)
    column = np.indices(SHAPE)[1]
    return {
        "blobs": lambda: 3000 * np.exp(11 * gaussian_filter(rng.normal(size=SHAPE), 4)),
        "grain": lambda: 3000 * np.exp(1.8 * gaussian_filter(rng.normal(size=SHAPE), 1)),
        "noise": lambda: 3000 * np.exp(0.3 * rng.normal(size=SHAPE)),
        "bars": lambda: np.where(column // 23 % 2, 8000.0, 800.0),
        "ramp": lambda: 10 ** (1 + 4 * column / SHAPE[1]),
        "wall": lambda: np.full(SHAPE, 3000.0),
        "dark": lambda: np.full(SHAPE, 0.1),
    }[kind]()


def moved(image, column_px, row_px):
    """The image as it lies this far right and down."""
    return np.abs(np.fft.ifft2(fourier_shift(np.fft.fft2(image), (row_px, column_px))).real)


def patches(frames):
    return survey_patches(list(frames))


@pytest.mark.parametrize("kind", ["blobs", "grain", "noise", "bars", "ramp", "wall", "dark"])
def test_a_static_stack_is_never_called_moved(kind):
    """Over 12 stacks of 4 pairs: significance evenly distributed as chance is, deviations as predicted."""
    rng, image = np.random.default_rng(1), scene(kind)
    found = [alignment(patches(photograph(image, EXPOSURE_S, rng)), EXPOSURE_S, SENSOR) for _ in range(12)]
    shifts = [shift for one in found for shift in one.shifts]
    assert not [shift for shift in shifts if shift.status == ShiftStatus.SHIFTED]
    assert kstest([shift.significance for shift in shifts], "uniform").pvalue > 1e-3
    pulls = np.concatenate([(s.shift_px / s.sigma_px)[np.isfinite(s.sigma_px)] for s in shifts])
    if pulls.size:
        assert np.sqrt(np.mean(pulls**2)) == pytest.approx(1, abs=5 / np.sqrt(2 * pulls.size))
    assert max(one.moved_share for one in found) < 5e-4


@pytest.mark.parametrize("kind", ["wall", "dark"])
def test_a_scene_without_edges_determines_nothing(kind):
    raw = photograph(scene(kind), EXPOSURE_S, np.random.default_rng(0))
    found = alignment(patches(raw), EXPOSURE_S, SENSOR)
    assert {shift.status for shift in found.shifts} == {ShiftStatus.UNDETERMINED}
    assert found.worst is None


def test_bars_determine_one_direction():
    image = scene("bars")
    raw = [photograph(image, [0.1], np.random.default_rng(0))[0]]
    raw.append(photograph(moved(image, 0.4, 0), [0.2], np.random.default_rng(1))[0])
    (shift,) = alignment(patches(raw), [0.1, 0.2], SENSOR).shifts
    assert shift.status == ShiftStatus.SHIFTED
    assert np.isfinite(shift.sigma_px).tolist() == [True, False]
    assert shift.shift_px[0] == pytest.approx(0.4, abs=0.1)  # hard edges, of which quads do not resolve everything


@pytest.mark.parametrize("shift_px", [(0.3, 0.0), (0.0, -0.2), (1.2, 0.7), (5.0, 3.0), (-9.0, 4.0)])
def test_a_shift_between_two_exposures_is_found_and_placed(shift_px):
    """To a tenth of a pixel, and a tenth of itself in fine grain, of which quads do not resolve everything."""
    for kind, share in (("blobs", 0.02), ("grain", 0.12)):
        image, rng = scene(kind), np.random.default_rng(2)
        stack = [photograph(image if t < 0.5 else moved(image, *shift_px), [t], rng)[0] for t in EXPOSURE_S]
        found = alignment(patches(stack), EXPOSURE_S, SENSOR)
        assert (found.worst.one, found.worst.other) == (2, 3)
        error = np.hypot(*(found.worst.shift_px - shift_px))
        assert error < 0.1 + share * np.hypot(*shift_px)
        assert found.worst.refused == (np.hypot(*shift_px) > 0.5)
        assert found.moved_share > 1e-3
        assert [s.status for s in found.shifts if s.one != 2] == [ShiftStatus.ALIGNED] * 3
    assert "c and d: the picture moved by" in str(shift_error(found.worst, "abcde"))


@quick
@given(st.floats(1e-4, 1e4), st.floats(0.6, 1.6), st.integers(0, 2**32))
def test_units_flicker_and_order_do_not_matter(unit, flicker, seed):
    image, times = scene("blobs"), np.array([0.05, 0.2])
    rng = np.random.default_rng(seed)
    raw = np.stack([photograph(image, [0.05], rng)[0], photograph(moved(image, 0.6, -0.4), [0.2 * flicker], rng)[0]])
    (one,) = alignment(patches(raw), times, SENSOR).shifts
    (other,) = alignment(patches(raw[::-1]), times[::-1] * unit, SENSOR).shifts
    assert (other.one, other.other) == (1, 0)
    np.testing.assert_allclose(other.shift_px, one.shift_px, atol=1e-3)
    np.testing.assert_allclose(one.shift_px, [0.6, -0.4], atol=0.1)


def test_a_part_that_moved_is_told_and_does_not_shift_the_rest():
    image, rng = scene("blobs"), np.random.default_rng(0)
    raw = photograph(image, EXPOSURE_S, rng)
    raw[2, :, :80] = photograph(moved(image, 7, 2), EXPOSURE_S[2:3], rng)[0, :, :80]
    found = alignment(patches(raw), EXPOSURE_S, SENSOR)
    assert found.worst is None
    assert 0.1 < found.moved_share < 0.3  # of the quarter, as far as patches fall into it


def test_missing_and_saturated_samples_are_left_out():
    image = scene("blobs")
    image[:, 100:140] = 1e7
    raw = photograph(image, EXPOSURE_S, np.random.default_rng(0)).astype(np.float32)
    raw[1, 30:60] = np.nan
    found = alignment(patches(raw), EXPOSURE_S, SENSOR)
    assert {shift.status for shift in found.shifts} == {ShiftStatus.ALIGNED}
    assert found.moved_share < 5e-4
    nothing = alignment(patches(np.full_like(raw, np.nan)), EXPOSURE_S, SENSOR)
    assert {shift.status for shift in nothing.shifts} == {ShiftStatus.UNDETERMINED}


def test_small_images_and_single_frames_determine_nothing():
    assert alignment(np.zeros((1, 2, 64, 64)), [1.0], SENSOR).shifts == ()
    (shift,) = alignment(np.full((2, 1, 8, 8), 500.0), [1.0, 2.0], SENSOR).shifts
    assert shift.status == ShiftStatus.UNDETERMINED


@pytest.mark.parametrize(("shape", "times"), [((2, 8, 8), [1, 2]), ((2, 1, 8, 8), [1]), ((0, 1, 8, 8), [])])
def test_what_are_no_patches_is_refused(shape, times):
    with pytest.raises(ImageError):
        alignment(np.zeros(shape), times, SENSOR)
