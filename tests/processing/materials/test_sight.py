"""A sphere before a calibrated camera: where its centre is, and where its points are seen."""

import numpy as np
import pytest

from processing.cameras.calibration import CameraModel
from processing.cameras.lens import Pinhole
from processing.errors import ImageError
from processing.geometry import rotation_z
from processing.materials.limb import SphereImage
from processing.materials.sight import CircleSight, sight_of_body, sight_of_sphere
from processing.products import sphere_normals

RADIUS_M = 0.05
LENS = Pinhole(np.array([[2000.0, 0, 163.0], [0, 2000.0, 118.0], [0, 0, 1]]), np.array([-0.3, 0.1, 1e-3, -2e-3, 0]))


def camera(lens=LENS):
    """One that looks down from a metre, a little turned about all axes."""
    tilt, spin = 0.03, rotation_z(0.2)[:3, :3]
    down = np.array([[1.0, 0, 0], [0, -np.cos(tilt), np.sin(tilt)], [0, -np.sin(tilt), -np.cos(tilt)]])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = spin @ down, (0.004, -0.003, 1.0)
    return CameraModel(lens, pose, (240, 320))


def limb(seen, centre_m, shown=slice(None)):
    """Image points of the circle in which the cone of the eye touches the sphere."""
    way = seen.centre_m - centre_m
    distance = np.linalg.norm(way)
    axis = way / distance
    side = np.cross(axis, [1.0, 0, 0]) / np.linalg.norm(np.cross(axis, [1.0, 0, 0]))
    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)[:, None]
    ring = np.cos(angle) * side + np.sin(angle) * np.cross(axis, side)
    sine = RADIUS_M / distance
    return seen.project(centre_m + RADIUS_M * (sine * axis + np.sqrt(1 - sine**2) * ring))[shown]


def circle_of(limb_px):
    middle = limb_px.mean(axis=0)
    return SphereImage(middle, float(np.linalg.norm(limb_px - middle, axis=1).mean()), np.eye(3), limb_px)


@pytest.mark.parametrize("shown", [slice(None), slice(70)], ids=["whole", "a third of it"])
def test_the_limb_tells_the_centre_through_a_lens_that_distorts(shown):
    """Far off the axis, where the limb is no circle; the limb is exact, so the centre is."""
    centre_m = np.array([0.03, -0.02, 0.01])
    sight = sight_of_sphere(camera(), circle_of(limb(camera(), centre_m, shown)), RADIUS_M)
    np.testing.assert_allclose(sight.centre_m, centre_m, atol=1e-6)
    assert sight.view_distance == pytest.approx(np.linalg.norm(camera().centre_m - centre_m) / RADIUS_M)
    points = sphere_normals(7)
    seen_px = camera().project(centre_m + RADIUS_M * points @ sight.rig_from_view.T)
    np.testing.assert_allclose(sight.image_points(points), seen_px, atol=1e-3)


def test_axes_are_the_cameras_turned_toward_the_body():
    sight = sight_of_body(camera(), np.zeros(3))
    np.testing.assert_allclose(sight.rig_from_view.T @ sight.rig_from_view, np.eye(3), atol=1e-12)
    assert np.linalg.det(sight.rig_from_view) == pytest.approx(1)
    np.testing.assert_allclose(sight.rig_from_view[:, 2], -camera().centre_m / np.linalg.norm(camera().centre_m))
    assert (np.diag(sight.rig_from_view.T @ camera().rig_from_camera[:3, :3]) > 0.99).all()
    along, down = np.diff(sight.image_points(0.1 * np.array([[1.0, 0, 0], [0, 0, 0], [0, 1, 0]])), axis=0)
    assert along[0] < -10 * abs(along[1])
    assert down[1] > 10 * abs(down[0])


def test_without_distortion_both_sights_agree():
    """A sphere on the axis of a plain lens: the circle and the distance say all that the lens does."""
    plain = camera(Pinhole(LENS.matrix, np.zeros(5)))
    centre_m = plain.centre_m + plain.rig_from_camera[:3, 2]
    circle = circle_of(limb(plain, centre_m))
    points = sphere_normals(9)
    through_lens = sight_of_sphere(plain, circle, RADIUS_M).image_points(points)
    np.testing.assert_allclose(CircleSight(circle, 1 / RADIUS_M).image_points(points), through_lens, atol=0.02)


def test_a_limb_out_of_the_lens_field_is_told():
    strong = Pinhole(LENS.matrix, np.array([-2.0, 0, 0, 0, 0]))
    circle = circle_of(np.array([[9000.0, 0], [9000, 9000], [0, 9000], [-9000, 0]]))
    with pytest.raises(ImageError, match="forms no image"):
        sight_of_sphere(camera(strong), circle, RADIUS_M)
