import numpy as np
import pytest

from simulators.layout import HolderLayout, direction
from simulators.samples.brick import brick_relief
from simulators.samples.relief import ReliefSample, flat_relief
from simulators.scene import matt
from simulators.scene_holder import HolderScene

HOLDER = HolderLayout()


@pytest.fixture(scope="module")
def brick() -> HolderScene:
    return HolderScene(HOLDER, ReliefSample(brick_relief(HOLDER.opening_m, 1)))


def _solid(scene: HolderScene, points: np.ndarray) -> np.ndarray:
    """Whether points (n, 3) lie in the holder or in the sample: the scene's definition, said once more and plainly."""
    x, y, z = points.T
    far = np.maximum(np.abs(x), np.abs(y))
    ground = np.full(len(points), -np.inf)
    ground[far <= HOLDER.lower_m / 2] = -HOLDER.step_m
    ground[far <= HOLDER.upper_m / 2] = 0.0
    inside = far < HOLDER.opening_m / 2
    ground[inside] = scene.sample.heights(x[inside], y[inside])
    return z <= ground


def _rays(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays from one eye to points all over the holder and beyond."""
    rng = np.random.default_rng(seed)
    eye = direction(rng.uniform(-3, 3), rng.uniform(0.3, 1.5))
    targets = np.column_stack([rng.uniform(-0.055, 0.055, (count, 2)), np.zeros(count)])
    way = targets - eye
    return eye, way / np.linalg.norm(way, axis=1, keepdims=True)


@pytest.mark.parametrize("seed", range(4))
def test_first_hits_are_where_dense_sampling_finds_them(brick, seed):
    eye, way = _rays(60, seed)
    hits = brick.trace(eye, way)
    found = np.full(len(way), np.inf)
    found[hits.ray] = np.linalg.norm(hits.points - eye, axis=1)
    step = 5e-6
    for ray, far in zip(way, found, strict=True):
        start = (0.0005 - eye[2]) / ray[2]
        reach = (-HOLDER.step_m - 0.001 - eye[2]) / ray[2]
        distances = np.arange(start, reach, step)
        solid = _solid(brick, eye + distances[:, None] * ray)
        expected = distances[np.argmax(solid)] if solid.any() else np.inf
        assert far == expected or abs(far - expected) <= 2 * step


@pytest.mark.parametrize("polar", [0.3, 0.8, 1.2])
def test_shadows_are_those_of_dense_sampling(brick, polar):
    """Against points every 5 um on the way to the lamp; grazing rays may differ by the start's 5 um offset."""
    eye, way = _rays(400, 9)
    hits = brick.trace(eye, way)
    source = 0.9 * direction(-0.6, np.pi / 2 - polar)  # across the view, so that shadows are seen
    lit = brick.lit(hits, source)
    toward = source - hits.points
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    facing = np.einsum("nk,nk->n", toward, hits.normals) > 0
    starts = hits.points + 5e-6 * hits.normals
    lengths = np.arange(0, 0.009 / np.cos(polar), 5e-6)
    free = [not _solid(brick, p + lengths[:, None] * d).any() for p, d in zip(starts, toward, strict=True)]
    expected = facing & np.array(free)
    assert 0.1 < expected.mean() < 1.0
    assert np.mean(lit == expected) > 0.99


def test_the_brick_fills_its_box_and_no_more(brick):
    height = brick.sample.relief.height_m
    assert -HOLDER.depth_m <= height.min() < -0.0025
    assert -0.0006 < height.max() <= -0.0003
    assert 0 < brick.sample.relief.albedo.min() <= brick.sample.relief.albedo.max() < 1


def test_the_brick_tiles_without_a_seam(brick):
    """Steps across the border are like steps inside."""
    height = brick.sample.relief.height_m
    for axis in (0, 1):
        inside = np.abs(np.diff(height, axis=axis)).mean()
        across = np.abs(np.take(height, 0, axis=axis) - np.take(height, -1, axis=axis)).mean()
        assert across < 2.5 * inside


def test_normals_are_those_of_the_relief(brick):
    eye, way = _rays(300, 3)
    hits = brick.trace(eye, way)
    inside = np.max(np.abs(hits.points[:, :2]), axis=1) < HOLDER.opening_m / 2 - 0.001
    on_top = inside & (np.abs(hits.points[:, 2] - brick.sample.heights(hits.points[:, 0], hits.points[:, 1])) < 1e-6)
    x, y, _ = hits.points[on_top].T
    h = 0.06 / 512
    slope_x = (brick.sample.heights(x + h, y) - brick.sample.heights(x - h, y)) / (2 * h)
    slope_y = (brick.sample.heights(x, y + h) - brick.sample.heights(x, y - h)) / (2 * h)
    normals = np.column_stack([-slope_x, -slope_y, np.ones(len(x))])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    assert len(x) > 30
    np.testing.assert_allclose(hits.normals[on_top], normals, atol=1e-5)


def test_the_white_plate_lies_in_the_reference_plane():
    white = HolderScene(HOLDER, ReliefSample(flat_relief(HOLDER.opening_m, 0.0, 0.9)))
    eye, way = _rays(200, 4)
    hits = white.trace(eye, way)
    near = np.max(np.abs(hits.points[:, :2]), axis=1) < HOLDER.upper_m / 2 - 1e-6
    assert near.any()
    np.testing.assert_allclose(hits.points[near, 2], 0, atol=1e-9)
    np.testing.assert_allclose(hits.material.albedo, 0.9, rtol=1e-6)
    assert white.lit(hits, np.array([0.0, 0.0, 1.0]))[near].all()


def test_the_step_shades_the_lower_frame():
    white = HolderScene(HOLDER, ReliefSample(flat_relief(HOLDER.opening_m, 0.0, 0.9)))
    eye = np.array([0.0, 0.0, 1.0])
    targets = np.array([[0.040, 0, -0.008], [0.049, 0, -0.008], [-0.040, 0, -0.008]])
    way = (targets - eye) / np.linalg.norm(targets - eye, axis=1, keepdims=True)
    hits = white.trace(eye, way)
    np.testing.assert_allclose(hits.points, targets, atol=1e-9)
    low_from_behind = 0.9 * direction(np.pi, np.radians(45))
    assert white.lit(hits, low_from_behind).tolist() == [False, True, True]


def test_matt_material_has_no_gloss():
    assert not matt(3, 0.5).specular.any()
