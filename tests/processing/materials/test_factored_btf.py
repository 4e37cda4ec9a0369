"""The factored BTF: light from everywhere, and ways to store its maps."""

import numpy as np
import pytest

from processing.products import DirectionMesh, FactoredBtf
from tests.benchmarks.yardsticks.material_samples import rings

RIG = rings(((15, 12), (30, 12), (45, 12), (60, 12), (75, 12)))  # 12 x 5, without the top


def btf(rng, rank=3, channels=3, size=(4, 5)) -> FactoredBtf:
    """Any maps and weights."""
    mesh = DirectionMesh.from_directions(RIG)
    maps = rng.uniform(0, 1, (rank, len(RIG), *size, channels)).astype(np.float32)
    return FactoredBtf(maps, rng.normal(size=(rank, len(RIG))).astype(np.float32), mesh, mesh)


def test_shares_of_the_cosine_are_a_third_of_the_triangles_around_a_direction():
    """What reaches the border besides belongs to the border's directions."""
    mesh = DirectionMesh.from_directions(RIG)
    a, b, c = (mesh.directions[mesh.triangles[:, k], :2] for k in range(3))
    area = 0.5 * np.linalg.det(np.stack([b - a, c - a], axis=1))
    around = np.bincount(mesh.triangles.ravel(), np.repeat(area, 3) / 3, len(RIG)) / np.pi
    np.testing.assert_allclose(mesh.cosine_shares[:48], around[:48], rtol=0.01)
    assert (mesh.cosine_shares[48:] > around[48:]).all()
    assert mesh.cosine_shares.sum() == pytest.approx(1)


def test_ambient_light_is_the_mean_over_lights_spread_by_the_cosine(rng):
    material = btf(rng)
    spread = np.sqrt(rng.uniform(0, 1, 40_000)), rng.uniform(0, 2 * np.pi, 40_000)
    xy = np.column_stack([spread[0] * np.cos(spread[1]), spread[0] * np.sin(spread[1])])
    light = np.column_stack([xy, np.sqrt(1 - spread[0] ** 2)])
    uv, view = np.array([[0.3, 0.7]]), np.array([[0.36, -0.48, 0.8]])
    values = material.evaluate(np.repeat(uv, len(light), axis=0), light, np.repeat(view, len(light), axis=0))
    error = values.std(axis=0) / np.sqrt(len(light))
    assert (np.abs(material.ambient(uv, view)[0] - values.mean(axis=0)) < 4 * error + 1e-3 * np.abs(values).max()).all()


def test_a_matt_surface_sends_back_its_reflectance_of_ambient_light():
    mesh = DirectionMesh.from_directions(RIG)
    maps = np.full((1, len(RIG), 2, 2, 3), 0.2, np.float32)
    material = FactoredBtf(maps, np.ones((1, len(RIG)), np.float32), mesh, mesh)
    found = material.ambient(np.array([[0.1, 0.9]]), np.array([[0.0, 0.6, 0.8]]))
    assert found == pytest.approx(np.full((1, 3), 0.2), rel=1e-6)
