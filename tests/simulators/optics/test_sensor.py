import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulators.chance import generator
from simulators.sensor import Sensor, build_unit
from tests.reference.sensor import electrons

SENSOR = Sensor()
SHAPE = (200, 250)  # 50 000 samples: the mean is known to 0.45 % of sigma, the variance to 0.63 %


def _electrons(mean_e: float, key: int = 0) -> np.ndarray:
    counts = SENSOR.expose(np.full(SHAPE, mean_e * 10, np.float32), 0.1, ("noise", mean_e, key))
    return (counts.astype(float) - SENSOR.black_dn) * SENSOR.gain_e_per_dn


@pytest.mark.parametrize("mean_e", [0.0, 0.7, 5.0, 49.0, 51.0, 400.0, 12000.0])
def test_noise_follows_the_model_on_both_sides_of_the_gaussian_limit(mean_e):
    """Variance = shot + read^2 + quantisation^2 / 12; five standard errors."""
    electrons = _electrons(mean_e)
    variance = mean_e + SENSOR.read_noise_e**2 + SENSOR.gain_e_per_dn**2 / 12
    assert electrons.mean() == pytest.approx(mean_e, abs=5 * np.sqrt(variance / electrons.size))
    assert electrons.var() == pytest.approx(variance, rel=5 * np.sqrt(2 / electrons.size) + 0.01)


def test_noise_profile_predicts_the_variance():
    slope, offset = SENSOR.noise_profile()
    span = SENSOR.white_dn - SENSOR.black_dn
    x = 0.5
    electrons = _electrons(x * span * SENSOR.gain_e_per_dn)
    measured = (electrons / SENSOR.gain_e_per_dn / span).var()
    assert measured == pytest.approx(slope * x + offset, rel=0.04)


def test_shot_noise_of_few_photons_is_skewed_like_poisson():
    """Third central moment of a Poisson count is its mean; a Gaussian's is 0."""
    electrons = np.concatenate([_electrons(20.0, key) for key in range(8)])
    third = np.mean((electrons - electrons.mean()) ** 3)
    assert third == pytest.approx(20.0, abs=8)


def test_saturation_stops_at_white():
    counts = SENSOR.expose(np.full(SHAPE, 1e6, np.float32), 1.0, ("bright",))
    assert counts.min() == counts.max() == SENSOR.white_dn


@settings(max_examples=30, deadline=None)
@given(st.lists(st.one_of(st.integers(), st.text(max_size=4)), max_size=5), st.floats(1e-4, 5))
def test_the_same_key_gives_the_same_bits_and_another_key_others(key, exposure_s):
    rate = np.full((8, 9), 900.0 / exposure_s, np.float32)
    first = SENSOR.expose(rate, exposure_s, tuple(key))
    SENSOR.expose(rate, exposure_s, ("between",))
    np.testing.assert_array_equal(SENSOR.expose(rate, exposure_s, tuple(key)), first)
    assert np.any(SENSOR.expose(rate, exposure_s, (*key, "other")) != first)


def test_hot_pixels_are_few_and_stay_where_they_are():
    dark = SENSOR.dark_current((500, 500), ("camera",))
    hot = dark >= 500
    assert 5 <= hot.sum() <= 60  # 25 expected
    assert dark[~hot].max() < 5
    assert dark[~hot].mean() == pytest.approx(SENSOR.dark_e_s, rel=0.01)
    np.testing.assert_array_equal(SENSOR.dark_current((500, 500), ("camera",)), dark)


def test_generators_do_not_confuse_numbers_and_texts():
    assert generator((1, "2")).random() != generator((1, 2)).random()


def test_a_unit_differs_from_its_model_by_what_its_key_says():
    first, again, other = (build_unit(SENSOR, (300, 400), key) for key in ((1, "a"), (1, "a"), (1, "b")))
    for name in ("offset_dn", "response", "dark_e_s"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
        assert np.any(getattr(first, name) != getattr(other, name))
    assert first.sensor == again.sensor != other.sensor
    assert first.sensor.gain_e_per_dn == pytest.approx(SENSOR.gain_e_per_dn, rel=0.015)
    assert first.sensor.read_noise_e == pytest.approx(SENSOR.read_noise_e, rel=0.05)
    assert first.sensor.noise_profile() != SENSOR.noise_profile()  # the file's is the model's
    assert first.offset_dn.std() == pytest.approx(0.5, rel=0.1)
    assert 0.004 < first.response.std() < 0.011


def test_the_unit_loses_its_compression_at_the_white_level_and_little_below():
    unit = build_unit(SENSOR, (100, 100), (2,))
    for share in (0.1, 0.5, 0.97):
        mean_e = share * (SENSOR.white_dn - SENSOR.black_dn) * unit.sensor.gain_e_per_dn
        counts = unit.expose(np.full((100, 100), mean_e, np.float32), 1.0, ("frame",)).astype(float)
        lost = 1 - (counts - SENSOR.black_dn).mean() / (mean_e / unit.sensor.gain_e_per_dn)
        assert lost == pytest.approx(unit.sensor.compression * share**2, abs=3e-4)
        assert electrons(counts, unit).mean() == pytest.approx(mean_e, rel=3e-4)
