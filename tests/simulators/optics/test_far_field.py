import numpy as np
import pytest

from simulators.far_field import btf, btf_below
from simulators.layout import HolderLayout, direction

DIRECTIONS = np.array([direction(*np.radians(pair)) for pair in ((0, 90), (20, 55), (140, 40), (260, 25))])


@pytest.fixture(scope="module", params=["brick", "pipe"])
def name(request) -> str:
    return request.param


@pytest.fixture(scope="module")
def reflectance(name) -> np.ndarray:
    return btf(name, 3, DIRECTIONS, DIRECTIONS, 32, 4)


def test_light_and_view_can_be_exchanged(reflectance):
    """Helmholtz: the mean over a period is the same; smooth normals on facets, and few rays, break that by percents."""
    mean = reflectance.mean(axis=(2, 3, 4))
    assert np.abs(mean - mean.T).max() < 0.06 * mean.mean()
    assert 0.02 < mean.min() < mean.max() < 0.5


def test_low_lights_cast_shadows_and_high_ones_hardly_any(reflectance):
    black = (reflectance.max(axis=-1) == 0).mean(axis=(2, 3))
    assert black[0, 0] < 0.02  # where light and view are one, all that is seen is lit
    assert 0.001 < black[3, 0] > black[1, 0] >= black[0, 0]
    assert np.diagonal(black).max() < 0.05


def test_the_rig_sees_nearly_the_same(optics, pose, studio):
    """Against the truth of lamp and camera a metre away, whose directions change by 2 deg over the sample.

    The holder hides 3 mm on each side of the brick's 60 mm.
    """
    camera, lamp, here = "cam6", "lamp4", pose(sample="brick")
    image = np.load(optics.truth("btf", here, camera=camera, lamp=lamp, texels=72)["path"])
    light = studio.lamp(here, lamp).position_m
    view = optics.layout.cameras[camera].rig_from_camera[:3, 3]
    light, view = ((end / np.linalg.norm(end))[None] for end in (light, view))
    found = btf("brick", optics.layout.seed, light, view, 80, 4)[0, 0, 4:76, 4:76]
    assert np.corrcoef(found.ravel(), image.ravel())[0, 1] > 0.9
    assert found.mean() == pytest.approx(image.mean(), rel=0.03)


def test_the_same_arguments_give_the_same_bits_and_another_seed_another_sample():
    first, again, other = (btf("brick", seed, DIRECTIONS[:1], DIRECTIONS[:2], 6, 2) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert np.any(first != other)


def test_a_texel_is_the_mean_over_finer_ones():
    """64 rays in one texel against 4 in each of 16: other places of rays, of which some cross an edge."""
    few = DIRECTIONS[1:2]
    coarse, fine = btf("brick", 3, few, few, 8, 64), btf("brick", 3, few, few, 32, 4)
    means = fine.reshape(8, 4, 8, 4, 3).mean(axis=(1, 3))
    assert np.sqrt(np.mean((coarse[0, 0] - means) ** 2)) < 0.2 * means.std()


def test_low_directions_and_other_samples_are_refused():
    low = np.array([[np.sqrt(1 - 0.15**2), 0.0, 0.15]])
    with pytest.raises(ValueError, match="lower than 80 deg"):
        btf("brick", 1, low, DIRECTIONS, 4)
    with pytest.raises(ValueError, match="'sphere' is not periodic: one of brick, weave"):
        btf("sphere", 1, DIRECTIONS, DIRECTIONS, 4)


def test_a_lower_plane_of_texels_is_the_same_picture_shifted_against_the_view():
    """The plane lies so deep that the view shifts by one texel; seen from straight above nothing moves."""
    period_m, texels, tangent = HolderLayout().opening_m, 8, 0.5
    up, slanted = np.array([0.0, 0.0, 1.0]), np.array([tangent, 0.0, 1.0]) / np.hypot(tangent, 1)
    views, depth_m = np.stack([up, slanted]), period_m / texels / tangent
    top = btf("brick", 3, up[None], views, texels, 2)
    below = btf_below("brick", 3, (up[None], views), texels, 2, depth_m)
    np.testing.assert_array_equal(below[0, 0], top[0, 0])
    np.testing.assert_allclose(below[0, 1], np.roll(top[0, 1], -1, axis=1), rtol=1e-4, atol=1e-5)
