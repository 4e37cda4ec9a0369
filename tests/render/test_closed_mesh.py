"""What encloses a volume is told from what does not, whatever its seams, order and scale."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from render.closed_mesh import is_closed
from render.mesh import Mesh, mesh_from_uv
from render.shapes import plane, sphere, statue, torus, vase

CLOSED = [sphere(shape=(8, 12)), torus(shape=(8, 12)), vase(shape=(16, 12)), statue(shape=(24, 16))]


def rows_mirrored(mesh: Mesh) -> Mesh:
    """The mesh with its texture folded along v: vertices where the two ways meet are doubled."""
    folded = np.column_stack([np.abs(mesh.uv[:, 0] - mesh.uv[:, 0].mean()), mesh.uv[:, 1]])
    return mesh_from_uv(mesh.positions, mesh.normals, folded, mesh.triangles)


@pytest.mark.parametrize("mesh", CLOSED, ids=["sphere", "torus", "vase", "statue"])
def test_seams_poles_and_mirrored_texture_do_not_open_a_mesh(mesh):
    assert is_closed(mesh)
    assert is_closed(rows_mirrored(mesh))


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), which=st.integers(0, len(CLOSED) - 1), scale=st.floats(1e-6, 1e6))
def test_any_order_place_and_scale(seed, which, scale):
    """Also with every triangle's corners on their own, as some files have them, in single precision; without any one
    triangle the mesh is open."""
    rng = np.random.default_rng(seed)
    mesh = CLOSED[which]
    corners = rng.permutation(mesh.triangles).ravel()
    loose = Mesh(
        (scale * (mesh.positions + rng.normal(size=3))).astype(np.float32).astype(np.float64)[corners],
        mesh.normals[corners],
        mesh.tangents[corners],
        mesh.uv[corners],
        np.arange(len(corners), dtype=np.int32).reshape(-1, 3),
    )
    assert is_closed(loose)
    assert not is_closed(replace(loose, triangles=loose.triangles[1:]))


def test_open_surfaces_are_open():
    assert not is_closed(plane())
    assert not is_closed(plane(shape=(4, 4)))


def test_a_triangle_the_wrong_way_round_opens_a_mesh():
    mesh = torus(shape=(8, 12))
    turned = mesh.triangles.copy()
    turned[5] = turned[5, ::-1]
    assert not is_closed(replace(mesh, triangles=turned))


def test_triangles_without_area_do_not_matter():
    """A corner twice is no triangle; what is left of a mesh of such alone encloses nothing."""
    mesh = torus(shape=(8, 12))
    flat = mesh.triangles[:10][:, [0, 1, 1]]
    assert is_closed(replace(mesh, triangles=np.concatenate([mesh.triangles, flat])))
    assert not is_closed(replace(mesh, triangles=flat))
    assert not is_closed(replace(mesh, positions=0.0 * mesh.positions))


def test_two_bodies_are_closed_if_both_are():
    one, other = CLOSED[0], CLOSED[1]
    both = np.concatenate([one.triangles, other.triangles + len(one.positions)])
    joined = [
        np.concatenate([getattr(one, name), getattr(other, name)])
        for name in ("positions", "normals", "tangents", "uv")
    ]
    assert is_closed(Mesh(*joined, both))
    assert not is_closed(Mesh(*joined, both[:-1]))
