"""The mirror ball: what its rays reach, and where and how bright the lamps are in it."""

from math import radians

import numpy as np
import pytest

from simulators.glint import Spots, add_spots, glint, reflection_points
from simulators.layout import MirrorLayout, direction
from simulators.lens import rays, sample_points
from simulators.scene_mirror import MirrorScene, fresnel

MIRROR = MirrorLayout(centre_m=(0.002, -0.001, 0.020))
SOURCES = np.array([[0.6, 0.2, 0.5], [-0.3, -0.8, 0.2], [0.0, 0.01, 0.9]])


def test_angles_of_incidence_and_reflection_are_equal():
    eye = np.array([0.7, 0.0, 0.7])
    at = reflection_points(MIRROR, SOURCES, eye)
    normal = (at - MIRROR.centre_m) / MIRROR.radius_m
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, rtol=1e-12)
    for source, point, n in zip(SOURCES, at, normal, strict=True):
        inward = (source - point) / np.linalg.norm(source - point)
        outward = (eye - point) / np.linalg.norm(eye - point)
        np.testing.assert_allclose(2 * (n @ inward) * n - inward, outward, atol=1e-12)


def test_a_distant_lamp_is_spread_evenly_over_all_directions(studio):
    """A ball under parallel light of irradiance E reflects E R^2 / 4 into every direction, whatever the angle."""
    camera = studio.layout.cameras["cam4"]
    eye = camera.rig_from_camera[:3, 3]
    perfect = MirrorLayout(centre_m=(0.0, 0.0, 0.020), refractive_index=1e6)  # reflects all light
    for elevation_deg, azimuth_deg in ((70, 0), (40, 90), (10, 140)):
        far_m = 300.0
        source = far_m * direction(radians(azimuth_deg), radians(elevation_deg))
        spots = glint(perfect, (source, 0.003, np.full(3, far_m**2)), camera, np.eye(4))
        distance_px = camera.matrix[0, 0] / (np.linalg.norm(eye) - 0.020 * np.sin(radians(60)))
        expected = perfect.radius_m**2 / 4 * distance_px**2
        # lens distortion and where on the ball the lamp is seen are under two percent of the scale, squared
        np.testing.assert_allclose(spots.light.sum(axis=0), expected, rtol=0.04)


@pytest.mark.parametrize(("cosine", "share"), [(1.0, 0.04), (0.0, 1.0)])
def test_glass_reflects_little_in_front_and_all_when_grazed(cosine, share):
    assert fresnel(np.array([cosine]), 1.5)[0] == pytest.approx(share, abs=1e-9)


def test_spots_keep_their_light_and_their_centroid():
    image = np.zeros((20, 30, 3), np.float32)
    add_spots(image, Spots(np.array([[12.3, 8.6], [0.2, 0.1]]), np.array([[5.0, 6.0, 7.0], [1.0, 1.0, 1.0]])), 0.5)
    inner = image[4:14, 7:18, 1]
    rows, columns = np.indices(inner.shape)
    assert inner.sum() == pytest.approx(6, rel=1e-6)
    # whole pixels shift the centroid of so narrow a spot by up to exp(-2 (pi 0.5)^2) / pi of a pixel
    assert (inner * columns).sum() / 6 + 7 == pytest.approx(12.3, abs=2.4e-3)
    assert (inner * rows).sum() / 6 + 4 == pytest.approx(8.6, abs=2.4e-3)
    assert 0.2 < image[:3, :3, 0].sum() < 1  # the second one is cut by the border


def test_rays_end_on_the_plate_also_by_way_of_the_ball(studio):
    camera = studio.layout.cameras["cam2"]
    scene = MirrorScene(MIRROR)
    eye = camera.rig_from_camera[:3, 3]
    ways = rays(camera, sample_points(camera, 1))
    hits = scene.trace(eye, ways)
    np.testing.assert_allclose(hits.points[:, 2], 0, atol=1e-12)
    assert np.abs(hits.points[:, :2]).max() <= MIRROR.plate_m / 2
    straight = np.linalg.norm(np.cross(hits.points - eye, ways[hits.ray]), axis=1) < 1e-9
    assert (hits.material.albedo[straight] == np.float32(0.03)).all()
    assert (hits.material.albedo[~straight] < 0.03).all()
    assert 0.01 < (~straight).mean() < 0.5


def test_the_ball_shades_the_plate_behind_it(studio):
    camera = studio.layout.cameras["cam7"]
    scene = MirrorScene(MIRROR)
    hits = scene.trace(camera.rig_from_camera[:3, 3], rays(camera, sample_points(camera, 1)))
    lit = scene.lit(hits, np.array([0.9, 0.0, 0.4]))
    assert hits.points[~lit, 0].max() < MIRROR.centre_m[0] + MIRROR.radius_m
    assert 0.02 < (~lit).mean() < 0.5


def test_the_picture_has_one_bright_spot_per_lamp(optics, pose):
    lit = pose(sample="mirror", lamps=(("lamp4", 1.0),))
    rate = optics.rate("cam5", lit) - optics.rate("cam5", pose(sample="mirror"))
    row, column = np.unravel_index(np.argmax(rate), rate.shape)
    around = rate.copy()
    around[row - 4 : row + 5, column - 4 : column + 5] = 0
    assert rate.max() > 300 * around.max()


def test_a_lamp_under_the_plate_is_hidden(studio):
    camera = studio.layout.cameras["cam3"]
    spots = glint(MIRROR, (np.array([0.0, 0.0, -0.5]), 0.003, np.ones(3)), camera, np.eye(4))
    assert not spots.light.any()
