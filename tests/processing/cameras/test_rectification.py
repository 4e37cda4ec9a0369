"""From camera pixels to texels: what is seen, what is not and why, energy, aliasing, ramps, variance."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing import geometry
from processing.cameras import resample_kernel
from processing.cameras.calibration import CameraModel
from processing.cameras.lens import Fisheye
from processing.cameras.rectification import Texels, TexelStatus, rectify
from processing.errors import ImageError
from processing.radiometry.hdr import PixelStatus, Radiance
from processing.radiometry.mosaic import cfa_channels
from tests.reference import rectification as twin
from tests.reference.plane_scene import MATRIX, RGGB, SIZE, camera_at, mosaic_of, photograph, waves

quick = settings(max_examples=25, deadline=None)
PHASES = [np.roll(RGGB, shift, axis=(0, 1)) for shift in ((0, 0), (0, 1), (1, 0), (1, 1))]
TEXTURED = Texels(24, 0.060)


def grey(value, variance=1.0):
    """A mosaic image (h, w) whose every pixel is good."""
    value = np.asarray(value, np.float32)
    return Radiance(value, np.full_like(value, variance), np.zeros(value.shape, np.uint8))


@pytest.mark.parametrize("elevation_deg", [88, 60, 35])
@pytest.mark.parametrize("turn_deg", [0, 90, -130])
@pytest.mark.parametrize("texels", [24, 60])
@pytest.mark.parametrize("mosaic", [False, True])
def test_a_plane_gives_its_texture_back(elevation_deg, turn_deg, texels, mosaic):
    camera, turn = camera_at(elevation_deg), geometry.rotation_z(np.radians(turn_deg))
    image = photograph(camera, turn, waves)
    rectified = rectify(
        mosaic_of(image) if mosaic else image, camera, turn, Texels(texels, 0.060), RGGB if mosaic else None
    )
    assert rectified.valid.all()
    truth = waves(rectified.texels.centres_m)
    # A box of width b damps a wave of period p by sinc(b / p) and a tent of half width h by sinc^2(h / p): the texel
    # is at most 2.5 mm, the tent at most 1 mm (2 mm foreshortened) with a mosaic's two pixels.
    tent_mm = (1.0 if mosaic else 0.5) / np.sin(np.radians(elevation_deg))
    damping = 1 - np.sinc(60 / texels / 15) * np.sinc(60 / texels / 15) * np.sinc(tent_mm / 15) ** 4
    np.testing.assert_allclose(rectified.value, truth, atol=damping + 0.01)


def test_a_fisheye_gives_the_texture_back_too():
    lens = Fisheye(MATRIX, np.array([0.02, -0.01, 0.0, 0.0]))
    camera = CameraModel(lens, camera_at(60).rig_from_camera, SIZE)
    rectified = rectify(mosaic_of(photograph(camera, np.eye(4), waves)), camera, np.eye(4), Texels(60, 0.060), RGGB)
    assert rectified.valid.all()
    np.testing.assert_allclose(rectified.value, waves(rectified.texels.centres_m), atol=0.1)


@quick
@given(st.integers(0, 2**32), st.integers(1, 2), st.floats(0.2, 4), st.floats(-5, 12))
def test_resampling_equals_its_numpy_twin(seed, reach, scale, shift):
    rng = np.random.default_rng(seed)
    planes, channel = (3, np.tile(np.arange(3, dtype=np.uint8), (2, 2, 1))) if reach == 1 else (1, RGGB[..., None])
    value = rng.normal(size=(11, 13, planes)).astype(np.float32)
    status = rng.choice([0, 0, 0, 0, 0, 1, 3, 4], value.shape).astype(np.uint8)
    value[status > 0] = np.nan
    variance = rng.uniform(0.1, 1, value.shape).astype(np.float32)
    corners = (
        np.stack(np.meshgrid(np.arange(5.0), np.arange(4.0)), -1) * scale + shift + rng.uniform(-0.2, 0.2, (4, 5, 2))
    )
    corners[0, 0] = np.nan
    got = resample_kernel.resample(value, variance, status, channel, corners, reach)
    wanted = twin.resample(value, variance, status, channel, corners, reach)
    for one, other in zip(got, wanted, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("cfa", PHASES, ids=str)
@pytest.mark.parametrize("texels", [7, 60, 400])
def test_a_constant_stays_constant(cfa, texels):
    """At every place of the Bayer pattern, from eighteen pixels a texel to a third of one."""
    rectified = rectify(grey(np.full(SIZE, 0.7)), camera_at(50), np.eye(4), Texels(texels, 0.06), cfa)
    np.testing.assert_allclose(rectified.value, np.float32(0.7), rtol=1e-6)


@pytest.mark.parametrize("cfa", PHASES, ids=str)
@pytest.mark.parametrize("texels", [20, 400])
def test_ramps_keep_their_place_and_their_colour(cfa, texels):
    """A ramp over the pixels has in all channels the value at the middle of the texel's image: no colour is shifted."""
    camera = camera_at(50)
    v, u = np.indices(SIZE)
    rectified = rectify(grey(3.0 + 0.05 * u - 0.02 * v), camera, np.eye(4), Texels(texels, 0.06), cfa)
    corners = camera.project(geometry.texel_corners(texels, 0.06))
    middle = (corners[1:, 1:] + corners[1:, :-1] + corners[:-1, 1:] + corners[:-1, :-1]) / 4
    truth = 3.0 + middle @ [0.05, -0.02]
    # Large footprints weigh the ends of a ramp as evenly as their points lie: a hundredth of a pixel.
    np.testing.assert_allclose(rectified.value, truth[..., None].repeat(3, -1), atol=1e-5 if texels == 400 else 1e-3)


def footprints_px(camera, texels):
    """Areas (n, n) of the texels' images."""
    corners = camera.project(geometry.texel_corners(texels.count, texels.side_m))
    one, other = corners[1:, 1:] - corners[:-1, :-1], corners[1:, :-1] - corners[:-1, 1:]
    return np.abs(one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]) / 2


@pytest.mark.parametrize("pattern", ["checker", "points"])
@pytest.mark.parametrize("texels", [12, 24, 50])
@pytest.mark.parametrize("mosaic", [False, True])
def test_the_light_of_patterns_finer_than_texels_is_kept(pattern, texels, mosaic):
    """The sum of radiance times area over the texels is that over the pixels: each pixel counts as its own area."""
    camera, rng = camera_at(60), np.random.default_rng(3)
    v, u = np.indices(SIZE)
    inside = np.hypot(u - 161, v - 118) < 45  # pixels, well within the square
    checker = (u // 6 + v // 6) % 2  # finer than 12 texels, with both phases of the mosaic in every square
    image = np.where(inside, checker if pattern == "checker" else rng.random(SIZE) < 0.02, 0.0).astype(np.float32)
    colour = np.repeat(image[..., None], 3, axis=-1)
    seen = grey(image) if mosaic else Radiance(colour, np.ones_like(colour), np.zeros(colour.shape, np.uint8))
    grid = Texels(texels, 0.06)
    rectified = rectify(seen, camera, np.eye(4), grid, RGGB if mosaic else None)
    total = np.einsum("yxc,yx->c", rectified.value, footprints_px(camera, grid))
    channels = cfa_channels(RGGB, SIZE)
    for c in range(3):
        wanted = image[channels == c].sum() / np.mean(RGGB == c) if mosaic else image.sum()
        # A pixel's weight varies by 3 % with its place among the points; a hundred lone points average that.
        assert total[c] == pytest.approx(wanted, rel=1e-3 if pattern == "checker" else 0.01)


@pytest.mark.parametrize("period_texels", [0.4, 0.7, 0.9])
def test_waves_too_fine_for_the_texels_are_damped(period_texels):
    """A box damps a wave by sinc(1 / period): to under 0.22 at these periods, all that point samples would alias."""
    grid = Texels(12, 0.06)

    def wave(points):
        one = 1 + np.sin(2 * np.pi * (points[..., 0] / (period_texels * 0.005) + 0.1))
        return np.repeat(one[..., None], 3, axis=-1)

    camera = camera_at(88)
    rectified = rectify(photograph(camera, np.eye(4), wave), camera, np.eye(4), grid)
    assert np.abs(rectified.value - 1).max() <= abs(np.sinc(1 / period_texels)) + 0.01


@quick
@given(st.floats(1e-3, 1e3))
def test_rectifying_is_linear(factor):
    camera = camera_at(50)
    image = photograph(camera, np.eye(4), waves)
    scaled = Radiance(image.value * np.float32(factor), image.variance * np.float32(factor**2), image.status)
    one, other = (rectify(i, camera, np.eye(4), Texels(8, 0.06)) for i in (image, scaled))
    np.testing.assert_allclose(other.value, one.value * factor, rtol=1e-5)
    np.testing.assert_allclose(other.variance, one.variance * factor**2, rtol=1e-5)


@pytest.mark.parametrize("mosaic", [False, True])
@pytest.mark.parametrize("texels", [16, 150])
def test_variance_is_that_of_the_mean(mosaic, texels):
    """Over noise images of uneven variance the scatter of a texel is what its variance says, small or large."""
    camera, rng = camera_at(60), np.random.default_rng(2)
    shape = SIZE if mosaic else (*SIZE, 3)
    variance = rng.uniform(0.5, 2, shape).astype(np.float32)
    squares = []
    for _ in range(40):
        noise = rng.standard_normal(shape, np.float32) * np.sqrt(variance)
        image = Radiance(noise, variance, np.zeros(shape, np.uint8))
        rectified = rectify(image, camera, np.eye(4), Texels(texels, 0.06), RGGB if mosaic else None)
        squares.append(rectified.value**2 / rectified.variance)
    # 40 x 768 squared samples: the mean of their ratio is known to 1 %; neighbours of small texels are not independent.
    assert np.mean(squares) == pytest.approx(1, abs=0.04)


def test_missing_pixels_are_left_out_and_large_gaps_stay_missing():
    camera = camera_at(88)
    image = photograph(camera, np.eye(4), lambda p: np.full(p.shape, 3.0))
    image.value[::3, ::3] = np.nan
    image.value[:, 170:230] = np.nan
    rectified = rectify(image, camera, np.eye(4), Texels(16, 0.06))
    assert set(np.unique(rectified.status)) == {TexelStatus.SEEN, TexelStatus.MISSING}
    np.testing.assert_allclose(rectified.value[rectified.valid], 3.0, rtol=1e-6)
    assert np.isnan(rectified.value[~rectified.valid]).any(-1).all()


def test_a_hot_pixel_takes_no_part():
    """Its neighbours of the same colour stand in for it, at every size of texel."""
    image = grey(np.full(SIZE, 2.0))
    image.value[100:140:5, 140:180:5] = np.nan
    image.status[100:140:5, 140:180:5] = PixelStatus.HOT
    for texels in (12, 60, 240):
        rectified = rectify(image, camera_at(60), np.eye(4), Texels(texels, 0.06), RGGB)
        np.testing.assert_allclose(rectified.value[rectified.valid], 2.0, rtol=1e-6)
        assert rectified.valid.mean() > 0.98
        assert set(np.unique(rectified.status)) <= {TexelStatus.SEEN, TexelStatus.MISSING}


def test_saturated_pixels_spoil_their_texels():
    """Without them the mean would be too dark: such a texel has no value, and says why."""
    image = grey(np.full(SIZE, 2.0))
    image.value[110:120, 150:160] = np.nan
    image.status[110:120, 150:160] = PixelStatus.SATURATED
    rectified = rectify(image, camera_at(88), np.eye(4), TEXTURED, RGGB)
    assert set(np.unique(rectified.status)) == {TexelStatus.SEEN, TexelStatus.SATURATED}
    assert 4 <= np.count_nonzero(~rectified.valid) <= 25
    assert np.isnan(rectified.value[rectified.status == TexelStatus.SATURATED]).any(-1).all()


def test_texels_outside_the_image_are_out_of_the_field():
    camera = camera_at(88)
    rectified = rectify(photograph(camera, np.eye(4), waves), camera, np.eye(4), Texels(16, 0.40))
    assert (rectified.status[0] == TexelStatus.OUT_OF_FIELD).all()
    assert rectified.valid[8, 8]
    for huge in (1e3, 1e30):
        corners = np.array([[[-huge, -huge], [huge, -huge]], [[-huge, huge], [huge, huge]]])
        one = np.ones((*SIZE, 1), np.float32)
        status = np.zeros(one.shape, np.uint8)
        *_, verdict = resample_kernel.resample(one, one, status, RGGB[..., None], corners, 2)
        assert verdict == TexelStatus.OUT_OF_FIELD


def test_a_sample_that_shows_its_back_is_averted():
    turned = geometry.rigid(np.diag([1.0, -1.0, -1.0]), [0, 0, 0])
    rectified = rectify(grey(np.ones(SIZE)), camera_at(60), turned, TEXTURED, RGGB)
    assert (rectified.status == TexelStatus.AVERTED).all()
    assert np.isnan(rectified.value).all()


@pytest.mark.parametrize("elevation_deg", [80, 45, 25])
def test_the_rim_hides_what_lies_behind_it(elevation_deg):
    """A rim of height d hides a strip of d / tan(elevation) on the camera's side, which is +X."""
    grid = Texels(60, 0.060, opening_m=0.058, rim_m=0.004)
    rectified = rectify(grey(np.ones(SIZE)), camera_at(elevation_deg), np.eye(4), grid, RGGB)
    hidden = rectified.status == TexelStatus.HIDDEN
    x, y = np.moveaxis(grid.centres_m[..., :2], -1, 0)
    outside = np.maximum(np.abs(x), np.abs(y)) > 0.029
    strip_m = 0.004 / np.tan(np.radians(elevation_deg))
    assert hidden[outside].all()
    # The camera stands a metre off: over the sample its elevation changes by three degrees at most.
    assert hidden[x > 0.029 - 0.9 * strip_m + 0.0002].all()
    assert not hidden[~outside & (x < 0.029 - 1.15 * strip_m) & (np.abs(y) < 0.028)].any()
    assert np.isnan(rectified.value[hidden]).all()
    np.testing.assert_allclose(rectified.value[rectified.valid], 1.0, rtol=1e-6)


@pytest.mark.parametrize("elevation_deg", [88, 30])
def test_texels_under_the_opening_are_those_of_a_camera_that_stands_higher(elevation_deg):
    depth_m, camera = 0.0013, camera_at(elevation_deg)
    raised = CameraModel(camera.lens, geometry.rigid(np.eye(3), [0, 0, depth_m]) @ camera.rig_from_camera, SIZE)
    image = photograph(camera, np.eye(4), waves)
    deep, level = Texels(24, 0.060, 0.058, depth_m, depth_m), Texels(24, 0.060, 0.058, depth_m)
    below, same = rectify(image, camera, np.eye(4), deep), rectify(image, raised, np.eye(4), level)
    np.testing.assert_array_equal(below.status, same.status)
    np.testing.assert_allclose(below.value, same.value, atol=1e-4)
    np.testing.assert_array_equal(deep.centres_m[..., 2], -depth_m)


@pytest.mark.parametrize("shape", [(10, 10, 3), (240, 320), (240, 320, 4)])
def test_images_of_another_camera_are_refused(shape):
    zero = np.zeros(shape, np.float32)
    with pytest.raises(ImageError, match="does not fit"):
        rectify(Radiance(zero, zero, zero.astype(np.uint8)), camera_at(60), np.eye(4), Texels(8, 0.06))


def test_a_pattern_that_is_none_is_refused():
    with pytest.raises(ImageError, match="Bayer"):
        rectify(grey(np.ones(SIZE)), camera_at(60), np.eye(4), TEXTURED, np.full((2, 2), 3, np.uint8))
