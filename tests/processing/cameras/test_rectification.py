"""From camera pixels to texels, and from radiance to reflectance."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing import geometry
from processing.cameras import resample_kernel
from processing.cameras.calibration import CameraModel
from processing.cameras.lens import Pinhole
from processing.cameras.rectification import (
    Rectified,
    WhiteFrame,
    WhiteRadiance,
    rectify,
    reflectance,
    white_frame_radiance,
)
from processing.errors import ImageError
from processing.radiometry.hdr import Radiance
from processing.radiometry.mosaic import cfa_channels
from tests.reference import rectification as twin

quick = settings(max_examples=25, deadline=None)
SIZE = (240, 320)
MATRIX = np.array([[2000.0, 0, 161], [0, 2004, 118], [0, 0, 1]])
DISTORTION = np.array([-0.1, 0, 0, 0, 0])
RGGB = np.array([[0, 1], [1, 2]], np.uint8)
FRAME = WhiteFrame(opening_m=0.060, outer_m=0.076)


def camera_at(elevation_deg):
    e = np.radians(elevation_deg)
    pose = geometry.look_at(np.array([np.cos(e), 0, np.sin(e)]), np.zeros(3))
    return CameraModel(Pinhole(MATRIX, DISTORTION), pose, SIZE)


def photograph(camera, rig_from_sample, radiance_at):
    """Noise-free colour image of the plane z = 0: `radiance_at` of sample-frame points (h, w, 3)."""
    met = geometry.intersect_plane(camera.centre_m, camera.pixel_rays(), [0, 0, 1], 0.0)
    points = geometry.transform_points(geometry.invert(rig_from_sample), met)
    value = radiance_at(points).astype(np.float32)
    return Radiance(value, np.ones_like(value), np.zeros(value.shape, np.uint8))


def mosaic_of(colour):
    channels = cfa_channels(RGGB, colour.value.shape[:2])[..., None]
    value, variance = (np.take_along_axis(a, channels, -1)[..., 0] for a in (colour.value, colour.variance))
    return Radiance(value, variance, np.zeros(value.shape, np.uint8))


def waves(points):
    """A smooth texture of 15 mm period, thirty pixels, three channels."""
    x, y = points[..., 0] / 0.015 * 2 * np.pi, points[..., 1] / 0.015 * 2 * np.pi
    return np.stack([2 + np.sin(x), 2 + np.cos(y), 2 + np.sin(x + y)], axis=-1)


@pytest.mark.parametrize("elevation_deg", [88, 60, 35])
@pytest.mark.parametrize("turn_deg", [0, 90, -130])
@pytest.mark.parametrize("texels", [24, 60])
@pytest.mark.parametrize("mosaic", [False, True])
def test_a_plane_gives_its_texture_back(elevation_deg, turn_deg, texels, mosaic):
    camera, turn = camera_at(elevation_deg), geometry.rotation_z(np.radians(turn_deg))
    image = photograph(camera, turn, waves)
    rectified = rectify(mosaic_of(image) if mosaic else image, camera, turn, texels, 0.060, RGGB if mosaic else None)
    assert rectified.valid.all()
    truth = waves(geometry.texel_grid(texels, 0.060))
    # A box of width b damps a wave of period p by sinc(b / p) and a tent of half width h by sinc^2(h / p): the texel
    # is at most 2.5 mm, the tent at most 1 mm (2 mm foreshortened) with a mosaic's two pixels.
    tent_mm = (1.0 if mosaic else 0.5) / np.sin(np.radians(elevation_deg))
    damping = 1 - np.sinc(60 / texels / 15) * np.sinc(60 / texels / 15) * np.sinc(tent_mm / 15) ** 4
    np.testing.assert_allclose(rectified.value, truth, atol=damping + 0.01)


@quick
@given(st.integers(0, 2**32), st.integers(1, 2), st.floats(0.2, 4), st.floats(-5, 12))
def test_resampling_equals_its_numpy_twin(seed, reach, scale, shift):
    rng = np.random.default_rng(seed)
    value = rng.normal(size=(2, 11, 13)).astype(np.float32)
    value[rng.random(value.shape) < 0.2] = np.nan
    variance = rng.uniform(0.1, 1, value.shape).astype(np.float32)
    corners = (
        np.stack(np.meshgrid(np.arange(5.0), np.arange(4.0)), -1) * scale + shift + rng.uniform(-0.2, 0.2, (4, 5, 2))
    )
    corners[0, 0] = np.nan
    share = np.array([1.0, 0.25])
    got = resample_kernel.resample(value, variance, corners, share, reach)
    wanted = twin.resample(value, variance, corners, share, reach)
    for one, other in zip(got, wanted, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-6)


@quick
@given(st.floats(1e-3, 1e3))
def test_rectifying_is_linear(factor):
    camera = camera_at(50)
    image = photograph(camera, np.eye(4), waves)
    scaled = Radiance(image.value * np.float32(factor), image.variance * np.float32(factor**2), image.status)
    one, other = (rectify(i, camera, np.eye(4), 8, 0.06) for i in (image, scaled))
    np.testing.assert_allclose(other.value, one.value * factor, rtol=1e-5)
    np.testing.assert_allclose(other.variance, one.variance * factor**2, rtol=1e-5)


def test_variance_is_that_of_the_mean():
    """Over noise images the scatter of a texel is what its variance says."""
    camera = camera_at(60)
    rng = np.random.default_rng(2)
    seen = []
    for _ in range(40):
        noise = rng.normal(size=(*SIZE, 3)).astype(np.float32)
        rectified = rectify(Radiance(noise, np.ones_like(noise), noise), camera, np.eye(4), 16, 0.06)
        seen.append(rectified.value)
    # 40 x 768 squared samples: the mean of their ratio is known to 1 %.
    ratio = np.mean(np.stack(seen) ** 2 / rectified.variance)
    assert abs(ratio - 1) < 0.05


def test_missing_pixels_are_left_out_and_large_gaps_stay_missing():
    camera = camera_at(88)
    image = photograph(camera, np.eye(4), lambda p: np.full(p.shape, 3.0))
    image.value[::3, ::3] = np.nan
    image.value[:, 170:230] = np.nan
    rectified = rectify(image, camera, np.eye(4), 16, 0.06)
    assert rectified.valid.any()
    assert not rectified.valid.all()
    np.testing.assert_allclose(rectified.value[rectified.valid], 3.0, rtol=1e-6)
    assert np.isnan(rectified.value[~rectified.valid]).any(-1).all()


def test_texels_outside_the_image_are_missing():
    camera = camera_at(88)
    image = photograph(camera, np.eye(4), waves)
    rectified = rectify(image, camera, np.eye(4), 16, 0.40)
    assert not rectified.valid[0].any()
    assert rectified.valid[8, 8]


@pytest.mark.parametrize("shape", [(10, 10, 3), (240, 320), (240, 320, 4)])
def test_images_of_another_camera_are_refused(shape):
    zero = np.zeros(shape, np.float32)
    with pytest.raises(ImageError, match="does not fit"):
        rectify(Radiance(zero, zero, zero), camera_at(60), np.eye(4), 8, 0.06)


def lamp_on_white(elevation_deg, distance_m):
    """Radiance of a white plate under a point lamp: its cosine over the squared distance."""
    e = np.radians(elevation_deg)
    lamp = distance_m * np.array([0.6 * np.cos(e), 0.8 * np.cos(e), np.sin(e)])

    def radiance_at(points):
        to_lamp = lamp - points
        level = 1e4 * to_lamp[..., 2] / np.linalg.norm(to_lamp, axis=-1) ** 3
        return level[..., None] * np.array([0.9, 1.0, 0.7])

    return radiance_at


@pytest.mark.parametrize("elevation_deg", [10, 40, 80])
@pytest.mark.parametrize("turn_deg", [0, 65])
def test_the_frame_tells_the_irradiance_under_the_sample(elevation_deg, turn_deg):
    camera, turn = camera_at(50), geometry.rotation_z(np.radians(turn_deg))
    light = lamp_on_white(elevation_deg, 0.9)

    def scene(points):
        ring = np.abs(points[..., :2]).max(-1) > FRAME.opening_m / 2
        shaded = (points[..., 0] > 0.01) & (points[..., 1] > 0)  # a quarter of the frame is in half shadow
        return light(points) * np.where(ring, np.where(shaded, 0.5, 1.0), 0.05)[..., None]

    rng = np.random.default_rng(5)
    image = photograph(camera, turn, scene)
    image.variance[:] = (0.01 * image.value) ** 2
    image.value[:] += rng.normal(size=image.value.shape) * np.sqrt(image.variance)
    white = white_frame_radiance(mosaic_of(image), camera, turn, FRAME, RGGB)
    points = geometry.texel_grid(16, FRAME.opening_m)
    error = white.radiance(points) / light(points) - 1
    # 1 % noise over some 700 frame texels and six coefficients gives 0.1 to 0.2 %; the quadratic itself 0.05 %.
    assert np.abs(error).max() < 0.01
    assert np.sqrt(np.mean(error**2)) < 0.004
    assert np.sqrt(white.variance(points)).max() < 0.01 * light(points).max()


def test_a_white_plate_has_its_own_reflectance():
    camera = camera_at(50)
    image = photograph(camera, np.eye(4), lamp_on_white(45, 0.9))
    image.variance[:] = (0.01 * image.value) ** 2
    white = white_frame_radiance(image, camera, np.eye(4), FRAME)
    plate = reflectance(rectify(image, camera, np.eye(4), 32, 0.06), white, 0.9)
    np.testing.assert_allclose(plate.value, 0.9 / np.pi, rtol=2e-3)
    assert (plate.variance > 0).all()


def test_reflectance_knows_both_uncertainties():
    """Variance of a ratio, to first order, for a flat white of 2 +- 0.1 and a radiance of 1 +- 0.2."""
    constant = np.eye(1, 6)
    covariance = np.broadcast_to(0.01 * constant.T @ constant, (3, 6, 6))
    white = WhiteRadiance(np.repeat(2.0 * constant, 3, axis=0), covariance, 0.03)
    ones = np.ones((4, 4, 3), np.float32)
    result = reflectance(Rectified(ones, ones * 0.04, ones[..., 0] > 0, 0.06), white, np.pi)
    np.testing.assert_allclose(result.value, 0.5, rtol=1e-6)
    np.testing.assert_allclose(result.variance, 0.04 / 4 + 0.01 / 16, rtol=1e-5)


def test_an_unseen_or_unlit_frame_is_an_error():
    camera = camera_at(50)
    for level in (-0.1, 0.0):
        dark = photograph(camera, np.eye(4), lambda p, level=level: np.full(p.shape, level))
        with pytest.raises(ImageError, match="dark"):
            white_frame_radiance(dark, camera, np.eye(4), FRAME)
    away = geometry.rigid(np.eye(3), [1.0, 0, 0])
    with pytest.raises(ImageError, match="not in the image"):
        white_frame_radiance(dark, camera, away, FRAME)
