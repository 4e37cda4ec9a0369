"""Photon transfer against sensors whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.errors import CalibrationError, ImageError
from processing.radiometry.frame_series import Frame, gather, levels
from processing.radiometry.hdr import PixelStatus, merge_exposures
from processing.radiometry.linearity import Linearity
from processing.radiometry.photon_transfer import measure_sensor
from processing.radiometry.sensor_calibration import SensorCalibration
from simulators.sensor import Sensor as SimulatedSensor
from tests.reference.sensor_frames import DARK_S, FLAT_S, Camera

SMALL = (64, 80)
SEEDS = 60


def measured(camera):
    return measure_sensor(camera.dark(), camera.flats(), camera.stated)


@pytest.fixture(scope="module")
def units():
    """Cameras of many seeds, and what photon transfer says of them."""
    cameras = [Camera(seed, SMALL) for seed in range(SEEDS)]
    return [(camera, measured(camera)) for camera in cameras]


def truth(camera, sound):
    sensor = camera.unit.sensor
    return {
        "black_dn": sensor.black_dn + camera.unit.offset_dn[sound].mean(),
        "gain_e_per_dn": sensor.gain_e_per_dn,
        "read_noise_e": sensor.read_noise_e,
        "dark_current_e_s": camera.unit.dark_e_s[sound].mean(),
        "response_spread": camera.unit.response[sound].std(),
        "offset_spread_dn": camera.unit.offset_dn[sound].std(),
        "nonlinearity": sensor.compression / (1 - sensor.compression),
        "light_drift_per_s": 0.0,
    }


def pulls(units, name):
    found = []
    for camera, result in units:
        figure = result.figures[name]
        found.append((figure.value - truth(camera, ~result.correction.hot)[name]) / figure.sigma)
    return np.array(found)


NAMES = tuple(truth(Camera(0, SMALL), np.ones(SMALL, bool)))


@pytest.mark.parametrize("name", NAMES)
def test_every_figure_is_right_within_its_own_sigma(units, name):
    """Normalised RMS of 60 seeds is 1 +- 0.09; three of those."""
    assert 0.73 < np.sqrt(np.mean(pulls(units, name) ** 2)) < 1.27


def test_all_figures_together_have_the_sigma_that_they_state(units):
    """480 of them: 1 +- 0.032."""
    together = np.concatenate([pulls(units, name) for name in NAMES])
    assert 0.9 < np.sqrt(np.mean(together**2)) < 1.1


def test_gain_and_read_noise_are_within_two_percent_of_every_unit(units):
    for camera, result in units:
        assert result.sensor.gain_e_per_dn == pytest.approx(camera.unit.sensor.gain_e_per_dn, rel=0.02)
        assert result.sensor.read_noise_e == pytest.approx(camera.unit.sensor.read_noise_e, rel=0.02)


def test_maps_are_the_pixels_own_within_their_variance(units):
    """The flat's error is what its variance says; the offsets know more than frames alone, the others' mean beside."""
    ratio, offset, dark = [], [], []
    for camera, result in units:
        pixels, sound = result.correction, ~result.correction.hot
        ratio.append(np.mean((pixels.flat - camera.flat)[sound] ** 2 / pixels.flat_variance[sound]))
        true_offset = camera.unit.offset_dn - camera.unit.offset_dn.mean()
        offset.append((pixels.offset_dn - true_offset)[sound].std())
        dark.append((pixels.dark_e_s - camera.unit.dark_e_s)[sound].std())
    assert np.mean(ratio) == pytest.approx(1, abs=0.03)
    assert np.mean(offset) < 0.32  # 16 frames with 1.04 dn each give 0.30 by the line's intercept; all alike would 0.5
    assert np.mean(dark) < 0.2  # as they differ, 0.15: far less than the 1.3 that a single pixel's line leaves


def test_hot_pixels_are_found_and_no_others(units):
    """Sixty units have some thirty pixels over 500 electrons per second."""
    found = wrong = there = 0
    for camera, result in units:
        hot = camera.unit.dark_e_s >= 500
        there += hot.sum()
        found += (result.correction.hot & hot).sum()
        wrong += (result.correction.hot & ~hot).sum()
    assert there > 10
    assert found == there
    assert wrong == 0


def test_linear_counts_grow_evenly(units):
    """Over the whole range to 2e-4, up to a scale: that of the smallest signals, which the gain shares, is noisier."""
    for camera, result in units:
        sensor = camera.unit.sensor
        share = np.linspace(0.05, 0.97, 20)
        counted = share * (1 - sensor.compression * share**2) * 3839
        ratio = result.linearity.linear_dn(counted) / (share * 3839)
        assert np.ptp(ratio) < 4e-4
        assert ratio.mean() == pytest.approx(1, abs=1e-3)
        np.testing.assert_allclose(result.linearity.counted_dn(result.linearity.linear_dn(counted)), counted)


def test_an_estimated_sensor_costs_no_efficiency(units):
    """Variance of the merge weighted by estimated noise over that by true noise, 1.5 to 4e5 e-/s: under 0.5 %."""
    times = np.geomspace(1 / 30, 2, 5)
    for camera, result in units:
        true, found = camera.unit.sensor, result.sensor
        dark = (true.read_noise_e**2 + true.gain_e_per_dn**2 / 12, found.dark_variance_e2)
        for rate in np.geomspace(1.5, 4e5, 20):
            used = times[rate * times < 15000]
            variance, stated = rate * used + dark[0], rate * used + dark[1]
            best = 1 / (used**2 / variance).sum()
            ours = ((used / stated) ** 2 * variance).sum() / (used**2 / stated).sum() ** 2
            assert ours / best - 1 <= 0.005


def test_a_measured_sensor_merges_to_the_truth_within_its_variance():
    """Bracketed frames of a step wedge through offsets, compression, uneven pixels and vignetting."""
    camera = Camera(3, (120, 160))
    calibration = SensorCalibration("VC", "", 100, camera.stated, measured(camera))
    wedge = np.geomspace(20, 2e5, 160)[None, :] * np.ones((120, 1))
    flat, times = camera.flat, (0.02, 0.06, 0.2, 0.6, 2.0)
    frames = [camera.frame(t, wedge * flat, ("wedge", k)).raw_dn for k, t in enumerate(times)]
    counts = calibration.linear_dn(np.stack(frames))
    merged = merge_exposures(counts, times, calibration.sensor, calibration.correction)
    clear = np.isin(merged.status, (PixelStatus.OK, PixelStatus.DARK))
    assert clear.mean() > 0.99
    error = (merged.value - wedge)[clear] / np.sqrt(merged.variance[clear])
    # The scale is known to the gain's own 0.2 %, which no pixel's variance holds: a fifth of a sigma in the bright.
    assert np.sqrt(np.mean(error**2)) == pytest.approx(1, abs=0.06)
    raw = merge_exposures(np.stack(frames), times, camera.stated)
    assert np.nanmean(((raw.value - wedge)[clear] / np.sqrt(merged.variance[clear])) ** 2) > 2


@pytest.mark.parametrize("rate_e_s", [1.0, 10.0, 100.0])
def test_the_variance_in_the_dark_holds_what_is_not_known_of_the_maps(rate_e_s):
    """Sixteen dark frames know a pixel's black level to a quarter of its noise, alike in all exposures of a stack."""
    camera, times = Camera(3, (120, 160)), (0.02, 0.06, 0.2, 0.6, 2.0)
    calibration = SensorCalibration("VC", "", 100, camera.stated, measured(camera))
    frames = [camera.frame(t, rate_e_s * camera.flat, ("dim", k)).raw_dn for k, t in enumerate(times)]
    counts = calibration.linear_dn(np.stack(frames))
    merged = merge_exposures(counts, times, calibration.sensor, calibration.correction)
    assert np.nanvar(merged.value) / np.nanmean(merged.variance) == pytest.approx(1, abs=0.07)
    # The mean dark current's own 0.01 and black's, and the gain's 0.4 %.
    assert abs(np.nanmean(merged.value) - rate_e_s) < 0.05 + 0.005 * rate_e_s


@pytest.mark.parametrize(
    ("model", "gain"),
    [
        (SimulatedSensor(black_dn=1024, white_dn=65535, gain_e_per_dn=0.24, read_noise_e=2.0), 0.25),
        (SimulatedSensor(black_dn=16, white_dn=1023, gain_e_per_dn=15.0, read_noise_e=8.0), 14.0),
        (SimulatedSensor(black_dn=0, white_dn=4095, gain_e_per_dn=4.0, read_noise_e=0.1), 4.0),
    ],
    ids=["16 bit", "10 bit, read noise of half a count", "no black level"],
)
def test_other_converters(model, gain):
    camera = Camera(5, SMALL, model)
    camera.stated = replace(camera.stated, gain_e_per_dn=gain)
    if model.black_dn == 0:  # half of the dark samples would be cut off
        with pytest.raises(CalibrationError, match="cut off"):
            measured(camera)
        return
    result = measured(camera)
    for name in ("gain_e_per_dn", "read_noise_e"):
        figure, true = result.figures[name], getattr(camera.unit.sensor, name)
        assert abs(figure.value - true) < 4 * figure.sigma
    assert result.sensor.gain_e_per_dn == pytest.approx(camera.unit.sensor.gain_e_per_dn, rel=0.02)


@pytest.mark.parametrize("spread_dn", [0.0, 20.0])
def test_a_full_well_below_the_highest_code_is_found(spread_dn):
    """The files state 4095; the pixels stop at 3600, each at its own code."""
    rng = np.random.default_rng(0)
    wells = 3600 + np.rint(rng.normal(0, spread_dn, SMALL))

    def spoil(raw_dn, exposure_s, key):
        full = raw_dn.astype(float) >= wells
        noise = np.rint(np.random.default_rng(key[-1]).normal(0, 1, SMALL)) if spread_dn else 0
        return np.where(full, wells + noise, raw_dn).astype(np.uint16)

    camera = _Broken(spoil)
    result = measured(camera)
    assert 3600 - 3.5 * spread_dn - 10 < result.figures["saturation_dn"].value <= 3600 - 2 * spread_dn
    assert result.figures["saturation_dn"].sigma == 0
    for name in ("gain_e_per_dn", "read_noise_e", "nonlinearity"):
        figure, sensor = result.figures[name], camera.unit.sensor
        share = (result.figures["saturation_dn"].value - 256) / 3839
        true = sensor.compression * share**2 if name == "nonlinearity" else getattr(sensor, name)
        assert abs(figure.value - true) < 4 * figure.sigma + 2e-4 * (name == "nonlinearity"), name


def test_without_a_saturated_flat_the_stated_level_holds():
    result = measure_sensor(*_dimmer(Camera(2, SMALL)))
    assert result.figures["saturation_dn"].value == 4095
    assert np.isnan(result.figures["saturation_dn"].sigma)


def _dimmer(camera):
    return camera.dark(), camera.flats(FLAT_S[:8]), camera.stated


def test_frames_that_a_resumed_session_took_again_count_once():
    """A simulated rig that is started anew repeats its noise: the third and fourth frame are the first and second."""

    class Restarted(Camera):
        def frame(self, exposure_s, rate_e_s, key, taken_s=0.0):
            return super().frame(exposure_s, rate_e_s, (*key[:-1], key[-1] % 2), taken_s)

    twice, once = measured(Restarted(2, SMALL)), measured(Camera(2, SMALL, repeats=2))
    assert twice.sensor == once.sensor


def test_five_flats_of_two_frames_are_enough():
    """The channels, of different sensitivity, tell the curve together."""
    camera = Camera(1, (240, 320), repeats=2)
    result = measure_sensor(camera.dark((2.0, 0.1)), camera.flats((0.03, 0.08, 0.15, 0.2, 0.3)), camera.stated)
    for name in ("gain_e_per_dn", "read_noise_e", "nonlinearity"):
        figure, true = result.figures[name], truth(camera, ~result.correction.hot)[name]
        assert abs(figure.value - true) < 4 * figure.sigma, name


def test_a_linear_sensor_is_left_linear():
    camera = Camera(1, SMALL)
    camera.unit = replace(camera.unit, sensor=replace(camera.unit.sensor, compression=0.0))
    result = measured(camera)
    assert not result.linearity.significant
    calibration = SensorCalibration("VC", "", 100, camera.stated, result)
    frame = camera.frame(0.1, 1000.0, ("any",)).raw_dn
    assert calibration.linear_dn(frame) is frame


def test_a_light_that_drifts_is_corrected():
    """2 % over the series: without the correction linearity would be 1 % off."""
    steady, drifting = Camera(2, SMALL), Camera(2, SMALL, light=lambda t: 1 + 0.02 * (t / 28 - 0.5))
    result = measured(drifting)
    drift = result.figures["light_drift_per_s"]
    assert abs(drift.value - 0.02 / 28) < 4 * drift.sigma
    for name in ("gain_e_per_dn", "nonlinearity", "response_spread"):
        figure, true = result.figures[name], truth(steady, ~result.correction.hot)[name]
        assert abs(figure.value - true) < 4 * figure.sigma, name


def test_flicker_is_no_noise_of_the_sensor():
    """Each frame 0.5 % brighter or darker than the one before; the gain would be 30 % off."""
    camera = Camera(2, SMALL, light=lambda t: 1 + 0.005 * np.sin(100 * t))
    gain = measured(camera).figures["gain_e_per_dn"]
    assert abs(gain.value - camera.unit.sensor.gain_e_per_dn) < 4 * gain.sigma


class _Broken(Camera):
    """A camera some of whose frames are spoilt."""

    def __init__(self, spoil, **changes):
        super().__init__(2, SMALL, **changes)
        self._spoil = spoil

    def frame(self, exposure_s, rate_e_s, key, taken_s=0.0):
        frame = super().frame(exposure_s, rate_e_s, key, taken_s)
        return Frame(self._spoil(frame.raw_dn, exposure_s, key), frame.taken_s)


def _with_nan(raw_dn, exposure_s, key):
    values = raw_dn.astype(np.float32)
    values[3, 4] = np.nan
    return values


def _dead_red(raw_dn, exposure_s, key):
    values = raw_dn.copy()
    values[::2, ::2] = 256 + (np.indices(values[::2, ::2].shape).sum(axis=0) + key[-1]) % 3
    return values


def _other_gain(raw_dn, exposure_s, key):
    values = raw_dn.astype(float)
    values[::2, ::2] = (
        np.round(256 + 1.2 * (values[::2, ::2] - 256)) if key[0] == "flat" and exposure_s < 0.3 else values[::2, ::2]
    )
    return np.minimum(values, 4095).astype(np.uint16)


def _room_light(raw_dn, exposure_s, key):
    values = raw_dn.copy()
    values[::2, ::2] += np.uint16(20 * exposure_s) if key[0] == "dark" else np.uint16(0)
    return values


@pytest.mark.parametrize(
    ("camera", "dark_s", "flat_s", "error", "says"),
    [
        (Camera(2, SMALL, repeats=1), DARK_S, FLAT_S, CalibrationError, "two or more"),
        (_Broken(lambda raw, t, key: Camera(2, SMALL).frame(t, 0.0, ("same",)).raw_dn), DARK_S, FLAT_S,
         CalibrationError, "two or more"),
        (Camera(2, SMALL), (), FLAT_S, CalibrationError, "no dark frames"),
        (Camera(2, SMALL), DARK_S[:1], FLAT_S, CalibrationError, "one exposure only"),
        (Camera(2, SMALL), DARK_S, (), CalibrationError, "no flat frames"),
        (Camera(2, SMALL), DARK_S, (1.0, 1.5, 2.0), CalibrationError, "below saturation"),
        (Camera(2, SMALL), DARK_S, (0.0001, 0.0002, 0.0003, 0.0004), CalibrationError, "no light"),
        (Camera(2, SMALL), DARK_S, FLAT_S[::-1], ImageError, "must rise"),
        (Camera(2, SMALL), DARK_S[::-1], FLAT_S, ImageError, "must fall"),
        (Camera(2, SMALL, light=lambda t: 1 + 0.02 * t), DARK_S, FLAT_S, CalibrationError, "drifts"),
        (Camera(2, SMALL, light=lambda t: 1 + 0.05 * np.sin(100 * t)), DARK_S, FLAT_S, CalibrationError, "flickers"),
        (_Broken(_with_nan), DARK_S, FLAT_S, ImageError, "not finite"),
        (_Broken(_dead_red), DARK_S, FLAT_S, CalibrationError, "no light in the first channel"),
        (_Broken(_other_gain), DARK_S, FLAT_S, CalibrationError, "disagree"),
        (_Broken(_room_light), DARK_S, FLAT_S, CalibrationError, "cap on the lens"),
        (_Broken(lambda raw, t, key: np.full_like(raw, 4095)), DARK_S, FLAT_S, CalibrationError, "cap on the lens"),
    ],
    ids=["one frame each", "the same frame again", "no dark", "one dark exposure", "no flat", "all saturated",
         "no light", "flats fall", "darks rise", "drift", "flicker", "NaN", "dead channel", "another gain",
         "light under the cap", "no cap"],
)  # fmt: skip
def test_what_cannot_be_measured_is_refused(camera, dark_s, flat_s, error, says):
    with pytest.raises(error, match=says):
        measure_sensor(camera.dark(dark_s), camera.flats(flat_s), camera.stated)


def test_dead_and_bright_pixels_are_not_used():
    def spoil(raw_dn, exposure_s, key):
        values = raw_dn.copy()
        values[10, 10], values[11, 20] = 256, np.minimum(256 + 2 * (values[11, 20].astype(int) - 256), 4095)
        return values

    result = measured(_Broken(spoil))
    assert result.correction.hot[10, 10]
    assert result.correction.hot[11, 20]
    assert result.correction.hot.sum() <= 4
    assert np.isfinite(result.correction.flat).all()


@settings(max_examples=15, deadline=None)
@given(st.permutations(range(5)), st.integers(0, 1000))
def test_a_series_does_not_depend_on_the_order_or_type_of_its_frames(order, seed):
    rng = np.random.default_rng(seed)
    frames = [Frame(rng.poisson(900, (16, 20)).astype(np.uint16), float(k)) for k in range(5)]
    everything = np.ones((16, 20), bool)
    first = levels(gather(frames, 0.1), everything)
    turned = [Frame(frames[k].raw_dn.astype(np.float32), frames[k].taken_s) for k in order]
    again = levels(gather(turned, 0.1), everything)
    for name in ("level_dn", "variance_dn2", "freedom", "flicker"):
        np.testing.assert_allclose(getattr(again, name), getattr(first, name), rtol=1e-9, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(st.floats(-0.02, 0.02), st.floats(-0.02, 0.02), st.floats(100, 60000))
def test_linearity_and_its_inverse_undo_each_other(quadratic, cubic, span_dn):
    curve = Linearity(span_dn, quadratic, cubic)
    counted = np.linspace(-0.05, 1, 50) * span_dn
    np.testing.assert_allclose(curve.counted_dn(curve.linear_dn(counted)), counted, atol=1e-9 * span_dn)
    assert (np.diff(curve.linear_dn(counted)) > 0).all()
    assert (curve.linear_dn(counted[counted <= 0]) == counted[counted <= 0]).all()
