"""The white card faces the camera that is to see it; what shades what follows from where it hangs."""

import numpy as np
import pytest

from simulators.clock import Clock
from simulators.faults import FaultSchedule
from simulators.layout import direction
from simulators.lens import project, rays, sample_points
from simulators.pose import Pose
from simulators.scene_sphere import SphereScene
from simulators.world import Mounted, MountError, World


@pytest.mark.parametrize("sample", ["sphere", "figure"])
@pytest.mark.parametrize("name", ["cam3", "cam7"])
def test_a_camera_of_the_arc_sees_the_whole_card_from_the_front(studio, name, sample):
    """11 x 40 mm from a metre away, to the right of the sample in its picture, with nothing in between."""
    camera = studio.layout.cameras[name]
    pose = Pose(sample, 0, 0.0, 0.0, 0.0, (), 0.0, False, None, camera.elevation_rad)
    eye_m = camera.rig_from_camera[:3, 3]
    hits = studio.trace(pose, eye_m, rays(camera, sample_points(camera, 1)))
    card = np.linalg.norm(hits.points, axis=1) > 0.0501
    assert np.ptp(hits.normals[card], axis=0).max() == 0
    np.testing.assert_allclose(hits.normals[card][0], direction(0.0, camera.elevation_rad), atol=1e-6)
    row, column = np.divmod(hits.ray[card], camera.width_px)
    pixel_mm = 1e3 / camera.matrix[0, 0]
    # to a pixel at each edge, and a percent of the distance
    assert len(row) * pixel_mm**2 == pytest.approx(11 * 40, rel=0.05)
    centre_px = project(camera, np.zeros((1, 3)))[0]
    np.testing.assert_allclose((column.mean(), row.mean()), centre_px + np.array([64 / pixel_mm, 0]), atol=2.0)


def test_the_card_of_the_front_camera_is_where_it_was(studio):
    """Its bits are those of every session so far."""
    up, out = SphereScene(studio.layout.sphere, 1, None).card.axes
    np.testing.assert_array_equal((up, out), [[0, 0, 1], [1, 0, 0]])
    assert studio.layout.sphere.facing(0.0) is studio.layout.sphere


def test_the_card_is_turned_by_hand_and_goes_back_with_the_next_sample(studio):
    world = World(Clock(), FaultSchedule(1, {}), studio.layout)
    before = world.place()
    world.mount(Mounted(sample="sphere", card="cam7"))
    assert world.pose().card_elevation_rad == studio.layout.cameras["cam7"].elevation_rad
    assert len(world.place()) == len(before) + 1  # another noise than before the front camera's card
    world.mount(Mounted(sample="sphere"))
    assert world.pose().card_elevation_rad == 0.0
    with pytest.raises(MountError, match="no camera 'cam9'"):
        world.mount(Mounted(card="cam9"))
