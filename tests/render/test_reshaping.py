"""Meshes made finer or of another size keep their surface."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from render.closed_mesh import is_closed
from render.errors import MeshError
from render.mesh import corner_angles
from render.reshaping import scaled, subdivided
from render.shapes import box, cylinder, plane, sphere

SIDES = st.floats(0.05, 20)


def areas(mesh):
    a, b, c = (mesh.positions[mesh.triangles[:, k]] for k in range(3))
    return np.cross(b - a, c - a) / 2


def volume(mesh):
    a, b, c = (mesh.positions[mesh.triangles[:, k]] for k in range(3))
    return (a * np.cross(b, c)).sum() / 6


def edges(mesh):
    corners = mesh.positions[mesh.triangles]
    return np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)


@settings(max_examples=12, deadline=None)
@given(sides=st.tuples(SIDES, SIDES, SIDES), longest=st.floats(0.02, 3))
def test_a_box_made_finer_is_the_same_box(sides, longest):
    """Closed, as large as before, no edge too long, every normal that of its side."""
    longest *= max(sides)
    mesh = subdivided(scaled(box(), np.array(sides)), longest)
    assert edges(mesh).max() <= longest
    assert is_closed(mesh)
    assert volume(mesh) == pytest.approx(np.prod(sides))
    facing = areas(mesh)
    facing /= np.linalg.norm(facing, axis=1, keepdims=True)
    assert np.abs(mesh.normals[mesh.triangles] - facing[:, None]).max() < 1e-9
    assert np.abs((mesh.tangents[:, :3] * mesh.normals).sum(axis=1)).max() < 1e-9


def test_curved_meshes_stay_closed_and_smooth():
    coarse = sphere(shape=(8, 12))
    fine = subdivided(coarse, 0.1)
    assert is_closed(fine)
    assert len(fine.positions) > 5 * len(coarse.positions)
    assert np.abs(np.linalg.norm(fine.normals, axis=1) - 1).max() < 1e-12
    assert (fine.normals * fine.positions).sum(axis=1).min() > 0.9
    assert np.abs(areas(fine).sum(axis=0)).max() < 1e-9


def test_what_is_fine_enough_is_left_alone():
    mesh = plane(2.0)
    assert subdivided(mesh, 3.0) is mesh


def test_triangles_keep_their_shape():
    """Halving all edges that are too long makes no needles of a square."""
    mesh = subdivided(plane(1.0), 0.1)
    assert corner_angles(mesh.positions, mesh.triangles).min() > np.deg2rad(20)


def test_stretched_normals_stay_square_to_the_surface():
    """Normals go with the inverse of the stretch: an ellipsoid's are known."""
    factors = np.array([0.5, 2.0, 1.0])
    mesh = scaled(sphere(), factors)
    gradient = mesh.positions / factors**2
    gradient /= np.linalg.norm(gradient, axis=1, keepdims=True)
    assert np.abs(mesh.normals - gradient).max() < 1e-9
    assert volume(scaled(cylinder(), factors)) == pytest.approx(volume(cylinder()))


def test_more_vertices_than_any_machine_likes_are_refused():
    with pytest.raises(MeshError, match="longer"):
        subdivided(plane(1e3), 1e-2)
