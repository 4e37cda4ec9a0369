from math import radians

import numpy as np
import pytest

from simulators.optics import Optics
from simulators.speckle import Speckle

CONTRAST = 0.1
COUNT, WIDTH_RAD = 20_000, 0.001


def _factors(speckle: Speckle, start: float, end: float) -> np.ndarray:
    """Of many pixels, for angles in widths of the stripe."""
    phases = speckle.phases(COUNT, ("test",))
    return speckle.passing(phases, np.full(COUNT, WIDTH_RAD), (0.8 + start * WIDTH_RAD, 0.8 + end * WIDTH_RAD))


@pytest.mark.parametrize("travel", [0.5, 1.0, 2.0])
def test_moving_speckle_has_its_contrast_and_decorrelates_with_the_stripes_travel(travel):
    speckle = Speckle(moving=CONTRAST, travel=travel)
    here = _factors(speckle, 0, 0)
    sigma = 1 / np.sqrt(COUNT)
    assert here.mean() == pytest.approx(1, abs=5 * CONTRAST * sigma)
    assert here.std() == pytest.approx(CONTRAST, rel=5 * sigma)
    for away in (0.25, 1.0, 2.0, 3.0):
        there = _factors(speckle, away * travel, away * travel)
        expected = np.exp(-(away**2) / 2)
        # eight waves stand for the whole spectrum: that leaves a twentieth
        assert np.corrcoef(here, there)[0, 1] == pytest.approx(expected, abs=0.06 + 5 * sigma)


def test_no_speckle_is_darker_than_black():
    factors = Speckle(still=0.3).fixed(COUNT, ("test",))
    assert factors.min() == 0.0  # at 3.3 sigma: some ten of these pixels
    assert factors.mean() == pytest.approx(1, abs=0.01)


def test_a_long_exposure_averages_moving_speckle():
    speckle = Speckle(moving=CONTRAST)
    steps = [_factors(speckle, at, at) for at in np.arange(0.05, 6, 0.1)]
    np.testing.assert_allclose(_factors(speckle, 0, 6), np.mean(steps, axis=0), atol=0.01 * CONTRAST)
    assert _factors(speckle, 0, 6).std() < 0.8 * CONTRAST


def test_pixels_and_keys_are_independent_and_the_same_angle_gives_the_same():
    speckle = Speckle(moving=CONTRAST)
    here = _factors(speckle, 1, 2)
    np.testing.assert_array_equal(here, _factors(speckle, 1, 2))
    assert abs(np.corrcoef(here[1:], here[:-1])[0, 1]) < 5 / np.sqrt(COUNT)
    other = speckle.passing(speckle.phases(COUNT, ("other",)), np.full(COUNT, WIDTH_RAD), (0.801, 0.802))
    assert abs(np.corrcoef(here, other)[0, 1]) < 5 / np.sqrt(COUNT)


def test_light_never_becomes_negative():
    assert _factors(Speckle(moving=1.0), 0, 0).min() == 0


def test_the_optics_move_their_speckle_only_when_asked_to(optics, pose, tmp_path):
    """With the moving part, frames differ from those without it by its contrast, and by nothing else."""
    moving = Optics(1, "small", tmp_path, Speckle(moving=CONTRAST))
    fan = [optics.layout.laser.fan_rad(ticks, radians(50)) for ticks in (240, 241)]
    swept = pose(laser_on=True, laser_sweep=tuple(fan))
    plain, other = optics.laser_rate("cam4", swept), moving.laser_rate("cam4", swept)
    bright = plain > 0.01 * plain.max()
    ratio = other[bright] / plain[bright]
    assert not other[plain == 0].any()
    assert ratio.std() == pytest.approx(CONTRAST, rel=5 / np.sqrt(2 * bright.sum()))
    np.testing.assert_array_equal(
        other, Optics(1, "small", tmp_path, Speckle(moving=CONTRAST)).laser_rate("cam4", swept)
    )


def test_without_speckle_the_stripe_is_smooth(optics, pose, tmp_path):
    """The default's still contrast is what tells it from a rig without any."""
    smooth = Optics(1, "small", tmp_path, Speckle(still=0.0))
    fan = optics.layout.laser.fan_rad(240, radians(50))
    swept = pose(laser_on=True, laser_sweep=(fan, fan))
    plain, other = optics.laser_rate("cam4", swept), smooth.laser_rate("cam4", swept)
    bright = plain > 0.01 * plain.max()
    ratio = plain[bright] / other[bright]
    assert ratio.std() == pytest.approx(0.03, rel=5 / np.sqrt(2 * bright.sum()))
