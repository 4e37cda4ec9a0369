"""The product that joins a BTF and the depth of its surface."""

import numpy as np
import pytest

from processing.errors import ImageError
from processing.products import DirectionMesh, FactoredBtf, Mesostructure
from tests.benchmarks.yardsticks.material_samples import rings

DIRECTIONS = rings(((0, 1), (40, 6), (70, 6)))
RNG = np.random.default_rng(5)


def mesostructure(depths: np.ndarray, step: float = 0.001) -> Mesostructure:
    """Depths (view, y, x) under a black BTF of as many texels."""
    mesh = DirectionMesh.from_directions(DIRECTIONS)
    maps = np.zeros((1, len(DIRECTIONS), *depths.shape[1:], 3), np.float32)
    return Mesostructure(
        FactoredBtf(maps, np.ones((1, len(DIRECTIONS)), np.float32), mesh, mesh), depths, step, mesh, 0.05
    )


def test_a_plane_has_one_depth_between_measured_views_too():
    """Its distance along the ray would not be linear between views; its depth is."""
    plane = mesostructure(np.full((len(DIRECTIONS), 4, 6), 120, np.uint8))
    view = RNG.normal(size=(50, 3))
    view[:, 2] = np.abs(view[:, 2])
    depth = plane.depth(RNG.uniform(-3, 3, (50, 2)), view / np.linalg.norm(view, axis=1, keepdims=True))
    np.testing.assert_allclose(depth, 0.12, rtol=1e-12)
    assert plane.deepest == pytest.approx(0.12)


def test_a_texel_seen_from_a_measured_view_is_the_stored_depth_and_repeats():
    depths = RNG.integers(0, 255, (len(DIRECTIONS), 4, 6)).astype(np.uint8)
    uv = np.array([[(2 + 0.5) / 6, (1 + 0.5) / 4], [(2 + 0.5) / 6 - 1, (1 + 0.5) / 4 + 2]])
    found = mesostructure(depths).depth(uv, DIRECTIONS[[5, 5]])
    np.testing.assert_allclose(found, depths[5, 1, 2] * 0.001, rtol=1e-9)


def test_saved_and_loaded_it_is_the_same(tmp_path):
    made = mesostructure(RNG.integers(0, 255, (len(DIRECTIONS), 4, 6)).astype(np.uint8))
    made.save(tmp_path / "one")
    loaded = Mesostructure.load(tmp_path / "one")
    np.testing.assert_array_equal(loaded.depths, made.depths)
    assert (loaded.step, loaded.plane) == (made.step, made.plane)
    with pytest.raises(ImageError):
        Mesostructure.load(tmp_path / "one" / "factored_btf")
