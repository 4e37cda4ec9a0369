"""From two bracketed fish-eye photographs to an environment: a small phone photographs a known room."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.cameras.lens import Fisheye
from processing.environment.brackets import Bracket, ProbePhotograph, merge_brackets
from processing.environment.capture import CaptureOptions, environment_of
from processing.environment.cloning import clone_clean
from processing.environment.fisheye_pair import FisheyePair, FisheyeView, cubemap_of_pair
from processing.environment.image_circle import CircleStatus, equidistant, find_circle
from processing.environment.reflections import common_layer, find_reflections, mask_of_rectangles
from processing.environment.registration import HALF_TURN, RegistrationStatus, View, register
from processing.errors import ImageError
from processing.products import Environment
from tests.benchmarks.yardsticks import phone_shots

RADIUS_PX = 80.0


@pytest.fixture(scope="module")
def shots(tmp_path_factory):
    room = phone_shots.room(3, 128)
    return phone_shots.photograph(room, tmp_path_factory.mktemp("shots"), seed=3, radius_px=RADIUS_PX)


@pytest.fixture(scope="module")
def photographs(shots):
    return merge_brackets(Bracket(shots.front), Bracket(shots.back))


@pytest.fixture(scope="module")
def captured(shots, photographs):
    return environment_of(photographs, CaptureOptions(phone_shots.FIELD_RAD, size=16, mask=shots.mask))


def test_a_sphere_is_lit_as_by_the_true_environment(shots, captured):
    """Within the 2 % that a diffuse sphere may be off, with the reflections marked."""
    truth = shots.truth(16)
    found = Environment((captured.environment.radiance * shots.unit).astype(np.float32))
    normals = np.random.default_rng(0).normal(size=(100, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    ours, true = found.irradiance(normals), truth.irradiance(normals)
    assert np.sqrt(np.mean((ours - true) ** 2)) < 0.02 * true.mean()
    assert captured.uncovered == 0.0


def test_the_image_circle_is_found(shots, captured):
    for circle in captured.circles:
        assert circle.status is CircleStatus.FOUND
        assert np.abs(circle.centre_px - shots.lens.matrix[:2, 2]).max() < 0.3
        assert abs(circle.radius_px - RADIUS_PX) < 0.3


def test_front_and_back_are_brought_together(shots, captured):
    """Within half a pixel at the rim, though the hand was some degrees off half a turn about every axis."""
    true = shots.world_from_front.T @ shots.world_from_back
    apart = captured.registration.front_from_back @ true.T
    angle = np.arccos(np.clip((np.trace(apart) - 1) / 2, -1, 1))
    assert np.arccos(np.clip((np.trace(true @ HALF_TURN.T) - 1) / 2, -1, 1)) > np.radians(1)
    assert angle < 0.5 / shots.lens.matrix[0, 0]
    assert captured.registration.status is RegistrationStatus.ALIGNED
    assert captured.registration.exposure_ratio == pytest.approx(1, abs=0.02)


def test_reflections_of_the_frame_are_found(shots, photographs, captured):
    """Most of what is marked is hidden by the frame, and most of what it hides is marked, on this small picture."""
    found = find_reflections(photographs[0].picture, photographs[1].picture, captured.circles)
    assert (found.front & shots.mask).sum() > 0.6 * (found.front | shots.mask).sum()
    assert found.count >= 3


def test_a_back_of_another_place_is_refused_unless_the_turn_is_given(tmp_path, shots, photographs, captured):
    rng = np.random.default_rng(4)
    other = ProbePhotograph(
        (photographs[1].picture * np.exp(rng.normal(size=photographs[1].picture.shape))).astype(np.float32),
        photographs[1].clipped, True, None,
    )  # fmt: skip
    turned = np.ascontiguousarray(np.rot90(other.picture[:, : other.picture.shape[0]], 1))
    size = np.minimum(turned.shape[:2], other.picture.shape[:2])
    mixed = other.picture.copy()
    mixed[: size[0], : size[1]] = turned[: size[0], : size[1]]
    views = [View(picture.mean(axis=-1), ~shots.mask) for picture in (photographs[0].picture, mixed)]
    lens = equidistant(captured.circles[0], phone_shots.FIELD_RAD)
    found = register(*views, lens, phone_shots.FIELD_RAD)
    assert found.status is not RegistrationStatus.ALIGNED
    with pytest.raises(ImageError, match="turn"):
        found.check()


def test_too_narrow_a_field_has_no_overlap_and_says_what_is_not_covered(shots, photographs, captured):
    narrow = np.radians(170.0)
    views = [View(photograph.luminance, ~shots.mask) for photograph in photographs]
    found = register(*views, captured.registration.lens, narrow)
    assert found.status is RegistrationStatus.NO_OVERLAP
    options = CaptureOptions(narrow, size=8, front_from_back=HALF_TURN, mask=shots.mask)
    gap = environment_of(photographs, options).uncovered
    # A band of 180 - 0.985 x 170 deg about the seam.
    assert gap == pytest.approx(np.sin(np.radians(90 - 0.985 * 85)), abs=0.03)


def view(lens, shape, rotation, light):
    return FisheyeView(light, lens, np.radians(94), rotation, np.ones(shape, bool))


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 1000), st.integers(-8, 2), st.floats(1e-4, 1e4))
def test_fish_eye_pixels_give_their_own_light_and_cover_the_sphere(seed, hundredths, scale):
    """Solid angles of pixels, of OpenCV's lens too, add up to the sphere; a uniform sky stays uniform to a percent."""
    rng, shape = np.random.default_rng(seed), (84, 90)
    lens = Fisheye(np.array([[23.0, 0, 44.3], [0, 23.1, 41.2], [0, 0, 1]]), np.array([hundredths / 100, 0.0, 0.0, 0.0]))
    off = phone_shots.geometry.rigid_from_vectors(rng.uniform(-0.05, 0.05, 3), np.zeros(3))[:3, :3]
    flat = scale * np.ones((*shape, 3))
    pair = FisheyePair(view(lens, shape, np.eye(3), flat), view(lens, shape, HALF_TURN @ off, flat))
    assert pair.solid_angles.sum() == pytest.approx(4 * np.pi, rel=0.005)
    np.testing.assert_allclose(cubemap_of_pair(pair, 8), scale, rtol=0.02)
    light = rng.exponential(size=(*shape, 3))
    light[20, 30] = 1e5
    bright = FisheyePair(view(lens, shape, np.eye(3), light), view(lens, shape, HALF_TURN @ off, light))
    total = Environment(cubemap_of_pair(bright, 8)).integral
    np.testing.assert_allclose(total, bright.solid_angles @ bright.radiance, rtol=1e-5)


@settings(max_examples=20, deadline=None)
@given(st.floats(38, 44), st.floats(-6, 6), st.floats(-6, 6), st.floats(1e-6, 1e6), st.integers(0, 99))
def test_circles_are_found_at_any_scale_of_light(radius, right, down, scale, seed):
    """To a fifth of a pixel, with a dark quarter of the rim and a glint outside of it."""
    rng = np.random.default_rng(seed)
    rows, columns = np.indices((104, 120))
    x, y = columns - (59.5 + right), rows - (51.5 + down)
    inside = np.clip(radius + 0.5 - np.hypot(x, y), 0, 1)
    scene = rng.uniform(0.5, 1.5, (104, 120)) * np.where((x > 0) & (y > 0), 1e-4, 1.0)
    picture = scale * inside * scene
    picture[2, 60] += scale
    found = find_circle(picture)
    assert found.status is CircleStatus.FOUND
    assert np.abs(found.centre_px - [59.5 + right, 51.5 + down]).max() < 0.3
    assert abs(found.radius_px - radius) < 0.3


@pytest.mark.parametrize("picture", [np.zeros((60, 80)), np.full((60, 80), np.nan), np.ones((60, 80)),
                                     np.random.default_rng(0).random((60, 80))])  # fmt: skip
def test_what_shows_no_circle_says_so(picture):
    found = find_circle(picture)
    assert found.status is CircleStatus.NOT_FOUND
    with pytest.raises(ImageError, match="no image circle"):
        found.check()


def test_the_common_layer_is_what_does_not_change():
    """Two scenes with the same patch on both: the layer is the patch, to a third of it where edges cross."""
    rows, columns = np.indices((40, 200))
    patch = 1.5 * ((np.abs(rows - 25) < 5) & (np.abs(columns - 100) < 20))
    one, other = np.where(columns % 60 < 30, 1.0, 0.0), np.where(rows < 12, 2.0, 0.0)
    layer = common_layer(one + patch, other + patch)
    layer -= layer[0, 0]
    assert np.abs(layer - patch).max() < 0.5
    np.testing.assert_allclose(common_layer(one + 7.0, other - 3.0), common_layer(one, other), atol=1e-9)
    np.testing.assert_allclose(common_layer(patch, patch), patch - patch.mean(), atol=1e-9)


def test_masks_of_rectangles_stay_in_the_picture():
    mask = mask_of_rectangles((20, 30), [(2, 3, 4, 5), (25, 0, 5, 20)])
    assert mask.sum() == 4 * 5 + 5 * 20
    assert mask[3, 2]
    assert not mask[2, 2]
    with pytest.raises(ImageError, match="not within"):
        mask_of_rectangles((20, 30), [(28, 0, 5, 5)])


def test_a_hidden_place_is_cloned_from_a_clean_one():
    """A scene that is alike all around its centre comes back under the mask, whatever was there; the rest stays."""
    rows, columns = np.indices((90, 90))
    radius = np.hypot(columns - 45, rows - 45)
    scene = np.exp(np.sin(radius / 2.0))[..., None] * np.array([1e-3, 1.0, 1e3])
    mask = mask_of_rectangles((90, 90), [(68, 38, 12, 10)])
    damaged = np.where(mask[..., None], np.nan, scene)
    found = clone_clean(damaged, mask, radius < 44, np.array([45.0, 45.0]))
    np.testing.assert_allclose(found[mask], scene[mask], rtol=0.1)
    np.testing.assert_array_equal(found[~mask], scene[~mask])


def test_photographs_without_exposure_data_are_refused_unless_the_plan_says_it(tmp_path, shots):
    from PIL import Image

    bare = []
    for path in shots.front:
        with Image.open(path) as image:
            image.save(tmp_path / path.name, quality=95, subsampling=0)
        bare.append(tmp_path / path.name)
    with pytest.raises(ImageError, match="no exposure time"):
        merge_brackets(Bracket(tuple(bare)), Bracket(tuple(bare)))
    with pytest.raises(ImageError, match="exposure times"):
        merge_brackets(Bracket(tuple(bare), (1.0,)), Bracket(tuple(bare), (1.0,)))


def test_a_field_that_no_lens_has_is_refused(captured):
    for field_rad in (0.0, np.nan, 7.0):
        with pytest.raises(ImageError, match="field of view"):
            equidistant(captured.circles[0], field_rad)


def test_a_halved_photograph_has_the_means_of_what_is_known():
    picture = np.arange(5 * 6 * 3, dtype=np.float32).reshape(5, 6, 3)
    picture[0, 0], picture[:2, 2:4] = np.nan, np.nan
    clipped = np.zeros((5, 6), np.bool_)
    clipped[3, 5] = clipped[4, 0] = True
    half = ProbePhotograph(picture, clipped, True, None).halved()
    assert half.picture.shape == (2, 3, 3)
    np.testing.assert_allclose(half.picture[0, 0], picture[[0, 1, 1], [1, 0, 1]].mean(axis=0))
    assert np.isnan(half.picture[0, 1]).all()
    np.testing.assert_allclose(half.picture[1, 2], picture[2:4, 4:].mean(axis=(0, 1)))
    assert np.argwhere(half.clipped).tolist() == [[1, 2]]
