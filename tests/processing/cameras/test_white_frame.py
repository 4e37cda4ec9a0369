"""From radiance to reflectance by the white frame around the sample."""

import numpy as np
import pytest

from processing import geometry
from processing.cameras.rectification import Rectified, Texels, rectify
from processing.cameras.white_frame import WhiteFrame, WhiteRadiance, reflectance, white_frame_radiance
from processing.errors import ImageError
from tests.reference.plane_scene import RGGB, camera_at, mosaic_of, photograph

FRAME = WhiteFrame(opening_m=0.060, outer_m=0.076)


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
    plate = reflectance(rectify(image, camera, np.eye(4), Texels(32, 0.06)), white, 0.9)
    np.testing.assert_allclose(plate.value, 0.9 / np.pi, rtol=2e-3)
    assert (plate.variance > 0).all()


def test_reflectance_knows_both_uncertainties():
    """Variance of a ratio, to first order, for a flat white of 2 +- 0.1 and a radiance of 1 +- 0.2."""
    constant = np.eye(1, 6)
    covariance = np.broadcast_to(0.01 * constant.T @ constant, (3, 6, 6))
    white = WhiteRadiance(np.repeat(2.0 * constant, 3, axis=0), covariance, 0.03)
    ones = np.ones((4, 4, 3), np.float32)
    result = reflectance(Rectified(ones, ones * 0.04, np.zeros((4, 4), np.uint8), Texels(4, 0.06)), white, np.pi)
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
