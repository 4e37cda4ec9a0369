"""Merging from those parts of the frames alone that tell something."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.errors import ImageError
from processing.formats.raw import map_raw
from processing.radiometry.adaptive import (
    PATCH_PX,
    SHARE,
    SURVEY,
    TILE_PX,
    merge_adaptively,
    survey,
    tile_slices,
)
from processing.radiometry.hdr import PixelStatus, merge_exposures
from processing.radiometry.sensor import PixelCorrection
from processing.radiometry.tile_kernel import tile_extremes
from tests.processing.radiometry.test_hdr import EXPOSURE_S, SENSOR, photograph
from tests.reference import tiles as twin
from tests.reference.dng import dng

TOLERANCE = 1e-4  # of a standard deviation: rounding of float32
quick = settings(max_examples=25, deadline=None)


@st.composite
def scenes(draw):
    """Radiance images with some levels, waves and grain, and exposures that may or may not resolve them."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    shape = (draw(st.integers(60, 200)), draw(st.integers(60, 200)))
    y, x = np.indices(shape)
    level = draw(st.floats(-1, 6))
    waves = draw(st.floats(0, 2)) * np.sin(y / draw(st.floats(5, 200)) + x / draw(st.floats(5, 200)))
    radiance = 10 ** np.minimum(level + waves + draw(st.floats(0, 0.3)) * rng.normal(size=shape), 8)
    exposure_s = 0.5 * draw(st.floats(1.2, 8)) ** -np.arange(draw(st.integers(2, 8)))
    return photograph(radiance, exposure_s, rng), exposure_s


def rms_by_tile(one, other):
    """Rms difference over the standard deviation of `other` in every tile, and its number of pixels."""
    error = (one.value - other.value) / np.sqrt(other.variance)
    for tile in np.argwhere(np.ones_like(survey(error.shape))):
        known = error[tile_slices(tuple(tile))]
        known = known[np.isfinite(known)]
        if known.size:
            yield float(np.sqrt(np.mean(known.astype(np.float64) ** 2))), known.size


@quick
@given(scenes(), st.sampled_from([0.0, 0.05, SHARE, 0.3]))
def test_no_tile_differs_by_more_than_its_share(scene, share):
    """A sample rms over n pixels is uncertain by 1 / sqrt(2 n) of itself; five times that is allowed."""
    raw, exposure_s = scene
    all_of_it = merge_exposures(raw, exposure_s, SENSOR)
    part = merge_adaptively(list(raw), exposure_s, SENSOR, share=share)
    for rms, pixels in rms_by_tile(part.radiance, all_of_it):
        assert rms <= share * (1 + 5 / np.sqrt(2 * pixels)) + TOLERANCE
    np.testing.assert_array_equal(np.isnan(part.radiance.value), np.isnan(all_of_it.value))
    saturated = all_of_it.status == PixelStatus.SATURATED
    np.testing.assert_array_equal(part.radiance.status == PixelStatus.SATURATED, saturated)
    report = part.report
    np.testing.assert_allclose(report.decoded + report.saturated + report.outweighed, 1)
    assert 1 / len(exposure_s) <= report.read_ratio + 1e-9 <= 1 + 2e-9


@quick
@given(scenes())
def test_variances_are_those_of_what_was_read(scene):
    raw, exposure_s = scene
    whole = merge_exposures(raw, exposure_s, SENSOR)
    part = merge_adaptively(list(raw), exposure_s, SENSOR).radiance
    clear = (whole.status == PixelStatus.OK) & (whole.value**2 > 100 * whole.variance)
    ratio = (part.variance / whole.variance)[clear]
    # One percent of the information may be left out; the estimate that the variance is taken at moves by 4 x share x
    # 1 / 10 of itself.
    assert np.all((ratio > 1 - 0.05) & (ratio < 1 + SHARE**2 + 0.05))


def test_bright_regions_do_not_need_long_exposures_and_dark_ones_no_short():
    radiance = np.full((16 * PATCH_PX, 16 * PATCH_PX), 20.0)
    radiance[:, 8 * PATCH_PX :] = 2e5
    raw = photograph(radiance, EXPOSURE_S, np.random.default_rng(0))
    report = merge_adaptively(list(raw), EXPOSURE_S, SENSOR).report
    assert report.saturated[4] > 0.4  # of the 0.5 that is bright; one patch of `SURVEY` is read all the same
    assert report.outweighed[0] > 0.4
    # Four of five frames in the dark half, three in the bright one: the first, and two that resolve it; and the survey.
    assert report.read_ratio < 0.7 + 0.3 / SURVEY + 0.02


def test_hot_pixels_do_not_make_a_dark_tile_bright():
    rng = np.random.default_rng(0)
    radiance = np.full((12 * PATCH_PX, 12 * PATCH_PX), 20.0)
    hot = rng.random(radiance.shape) < 1e-3
    raw = photograph(np.where(hot, 3e5, radiance), EXPOSURE_S, rng)
    flat, none = np.ones(hot.shape, np.float32), np.zeros(hot.shape, np.float32)
    correction = PixelCorrection(none, none, flat, hot, dark_variance=none, flat_variance=none)
    known = merge_adaptively(list(raw), EXPOSURE_S, SENSOR, correction)
    unknown = merge_adaptively(list(raw), EXPOSURE_S, SENSOR)
    assert known.report.outweighed[0] > unknown.report.outweighed[0] + 0.5
    np.testing.assert_array_equal(known.radiance.status == PixelStatus.HOT, hot)


def test_a_correction_is_that_of_the_whole_merge():
    rng = np.random.default_rng(1)
    shape = (2 * TILE_PX + 10, 3 * TILE_PX)
    maps = [rng.normal(1, 0.1, shape).astype(np.float32) for _ in range(3)]
    correction = PixelCorrection(maps[0], maps[1], maps[2], rng.random(shape) < 0.01)
    raw = photograph(10 ** rng.uniform(1, 4, shape), EXPOSURE_S, rng)
    part = merge_adaptively(list(raw), EXPOSURE_S, SENSOR, correction, share=0.0).radiance
    whole = merge_exposures(raw, EXPOSURE_S, SENSOR, correction)
    assert np.nanmax(np.abs(part.value - whole.value) / np.sqrt(whole.variance)) < 10 * TOLERANCE
    np.testing.assert_allclose(part.variance, whole.variance, rtol=0.02)
    assert np.mean(part.status != whole.status) < 1e-3
    np.testing.assert_array_equal(part.status == PixelStatus.HOT, correction.hot)


def test_mapped_files_merge_like_arrays(tmp_path):
    radiance = np.tile(np.geomspace(5, 3e5, 640), (320, 1))
    raw = photograph(radiance, EXPOSURE_S, np.random.default_rng(0))
    frames = []
    for number, mosaic in enumerate(raw):
        path = tmp_path / f"{number}.dng"
        path.write_bytes(dng(mosaic, noise_profile=(1e-3, 1e-6)))
        frames.append(map_raw(path).mosaic)
    one, other = merge_adaptively(frames, EXPOSURE_S, SENSOR), merge_adaptively(list(raw), EXPOSURE_S, SENSOR)
    np.testing.assert_allclose(one.radiance.value, other.radiance.value, rtol=1e-3, atol=0.1)
    assert one.report.read_ratio == other.report.read_ratio < 1


def test_the_survey_is_one_patch_of_so_many_in_all_quarters():
    for shape, pitch in (((1920, 2560), 25), ((768, 1024), SURVEY), ((1000, 1500), SURVEY), ((3000, 4000), 61)):
        picked = survey(shape)
        assert picked.mean() == pytest.approx(1 / pitch, rel=0.25)
        quarters = [half.mean() for rows in np.array_split(picked, 2) for half in np.array_split(rows, 2, axis=1)]
        assert min(quarters) > 0.4 / pitch
    assert survey((5, 7)).tolist() == [[True]]
    assert survey((256, 256)).all()


def test_a_curve_that_makes_counts_linear_comes_first():
    radiance = np.tile(np.geomspace(5, 3e5, 640), (320, 1))
    raw = photograph(radiance, EXPOSURE_S, np.random.default_rng(0))
    bent = np.rint((raw / 4096.0) ** 1.1 * 40960).astype(np.uint16)
    one = merge_adaptively(list(bent), EXPOSURE_S, SENSOR, linear_dn=lambda dn: 4096 * (dn / 40960.0) ** (1 / 1.1))
    other = merge_adaptively(list(raw), EXPOSURE_S, SENSOR)
    np.testing.assert_allclose(one.report.decoded, other.report.decoded, atol=0.03)
    clear = other.radiance.status == PixelStatus.OK
    error = (one.radiance.value - other.radiance.value)[clear] / np.sqrt(other.radiance.variance[clear])
    assert np.sqrt(np.mean(error**2)) < 0.2  # the share, and counts that were rounded twice


def test_extremes_equal_their_numpy_twin():
    rng = np.random.default_rng(0)
    raw = rng.integers(0, 65536, (150, 100)).astype(np.uint16)
    corners = np.argwhere(np.ones((3, 2), bool)) * TILE_PX
    for ignored in (np.zeros((0, 0), bool), rng.random(raw.shape) < 0.5, np.ones(raw.shape, bool)):
        found, expected = (f(raw, corners, TILE_PX, ignored) for f in (tile_extremes, twin.tile_extremes))
        np.testing.assert_array_equal(found, expected)


def test_what_does_not_fit_is_refused():
    frame = np.zeros((70, 70), np.uint16)
    for frames, times, share in (
        ([frame], [1, 2], 0.1),
        ([frame, frame[:60]], [1, 2], 0.1),
        ([], [], 0.1),
        ([frame], [np.nan], 0.1),
        ([frame], [1], 1.0),
        ([frame.astype(np.float32)], [1], 0.1),
    ):
        with pytest.raises(ImageError):
            merge_adaptively(frames, times, SENSOR, share=share)
