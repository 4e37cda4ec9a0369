import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulators.layout import build_layout
from simulators.lens import project, rays, sample_points, vignette

CAMERAS = build_layout(1, "small").cameras
NAMES = st.sampled_from(sorted(CAMERAS))


@settings(max_examples=40, deadline=None)
@given(NAMES, st.floats(-0.5, 1.5), st.floats(-0.5, 1.5), st.floats(0.3, 2.0))
def test_a_ray_comes_back_to_its_pixel(name, across, down, distance_m):
    camera = CAMERAS[name]
    uv = np.array([[across * camera.width_px, down * camera.height_px]])
    points = camera.rig_from_camera[:3, 3] + distance_m * rays(camera, uv)
    np.testing.assert_allclose(project(camera, points), uv, atol=1e-6)


@pytest.mark.parametrize("name", sorted(CAMERAS))
def test_the_origin_falls_where_a_pinhole_puts_it(name):
    """Near the axis the distortion does nothing: the matrix and the pose alone say where a point falls."""
    camera = CAMERAS[name]
    local = np.linalg.inv(camera.rig_from_camera) @ [0, 0, 0, 1]
    pinhole = camera.matrix @ local[:3]
    uv = project(camera, np.zeros((1, 3)))[0]
    assert np.linalg.norm(uv - pinhole[:2] / pinhole[2]) < 0.01


def test_image_axes_point_right_and_down():
    """From azimuth 0, +Y is to the right and +Z is up."""
    uv = project(CAMERAS["front"], np.array([[0, 0, 0], [0, 0.01, 0], [0, 0, 0.01]]))
    right, up = uv[1] - uv[0], uv[2] - uv[0]
    assert right[0] > 30
    assert up[1] < -30


def test_sampling_points_average_to_the_pixel_centre():
    camera = CAMERAS["cam0"]
    points = sample_points(camera, 3).reshape(camera.height_px, camera.width_px, 9, 2)
    np.testing.assert_allclose(points.mean(axis=2)[7, 11], (11, 7), atol=1e-12)
    assert np.abs(points[7, 11] - (11, 7)).max() < 0.5


def test_vignetting_is_mild_and_falls_outward():
    share = vignette(CAMERAS["front"])
    assert share.max() <= 1
    assert share.min() > 0.93
    assert share[240, 320] > share[240, 40] > share[5, 5]
