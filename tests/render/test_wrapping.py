"""Stretch and bending of meshes are those of the surfaces that they stand for, at seams and poles too."""

from dataclasses import replace

import numpy as np
import pytest

from render.mesh import Mesh, mesh_from_uv
from render.shapes import plane, sphere, statue, torus
from render.wrapping import wrapping


def errors_of_a_torus(shape):
    """Largest errors of stretch, relative, and of bending, of the tube's own."""
    mesh = torus(1.0, 0.4, tiles=(6.0, 2.0), shape=shape)
    here = wrapping(mesh)
    radius = np.hypot(*mesh.positions[:, :2].T)
    stretch = np.column_stack([2 * np.pi * radius / 6, np.full(len(radius), 2 * np.pi * 0.4 / 2)])
    around = (radius - 1.0) / 0.4 / radius
    bending = np.column_stack([around, 0 * radius, np.full(len(radius), 1 / 0.4)])
    return np.abs(here.stretch / stretch - 1).max(), 0.4 * np.abs(here.bending - bending).max()


def test_a_torus_is_approached_with_the_square_of_the_edges():
    coarse, fine = np.array(errors_of_a_torus((24, 48))), np.array(errors_of_a_torus((48, 96)))
    assert (coarse < 0.03).all()
    assert (fine < 0.35 * coarse).all()


def test_a_sphere_bends_alike_everywhere():
    """At its poles too, where the texture is pinched and frames of one place turn all ways."""
    here = wrapping(sphere(2.0, shape=(48, 96)))
    np.testing.assert_allclose(here.bending, np.broadcast_to([0.5, 0.0, 0.5], here.bending.shape), atol=2e-3)
    assert (here.stretch > 0).all()


def test_a_plane_is_flat_and_its_tiles_have_their_length():
    here = wrapping(plane(2.0, tiles=(4.0, 1.0)))
    np.testing.assert_allclose(here.stretch, np.broadcast_to([0.5, 2.0], (4, 2)))
    np.testing.assert_allclose(here.bending, 0.0, atol=1e-12)


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_a_larger_mesh_has_longer_tiles_and_bends_less(scale):
    mesh = statue(shape=(40, 30))
    one, other = wrapping(mesh), wrapping(replace(mesh, positions=scale * mesh.positions))
    np.testing.assert_allclose(other.stretch, scale * one.stretch, rtol=1e-9)
    np.testing.assert_allclose(other.bending * scale, one.bending, rtol=1e-6, atol=1e-6)


def test_mirrored_texture_keeps_lengths_and_bending():
    """Where the texture is mirrored b turns over, and tb with it."""
    mesh = torus(shape=(12, 30))
    mirrored = mesh_from_uv(mesh.positions, mesh.normals, mesh.uv * [-1.0, 1.0], mesh.triangles)
    one = wrapping(mesh_from_uv(mesh.positions, mesh.normals, mesh.uv, mesh.triangles))
    other = wrapping(mirrored)
    np.testing.assert_allclose(other.stretch, one.stretch)
    np.testing.assert_allclose(other.bending, one.bending * [1.0, -1.0, 1.0], atol=1e-9)
    assert (mirrored.tangents[:, 3] == -1.0).all()


def test_triangles_without_area_tell_nothing():
    """Corners that fall together, in space, in the texture, or in both, change nothing around them."""
    mesh = torus(shape=(12, 30))
    doubled = np.concatenate([mesh.triangles, mesh.triangles[:40][:, [0, 1, 1]]])
    one, other = wrapping(mesh), wrapping(replace(mesh, triangles=doubled))
    np.testing.assert_allclose(other.stretch, one.stretch)
    np.testing.assert_allclose(other.bending, one.bending)


def test_a_mesh_without_texture_or_extent_has_some_length():
    """Nothing is known, nothing is divided by zero."""
    mesh = torus(shape=(6, 8))
    untold = wrapping(replace(mesh, uv=0.0 * mesh.uv))
    assert (untold.stretch > 0).all()
    assert np.isfinite(untold.stretch).all()
    point: Mesh = replace(mesh, positions=0.0 * mesh.positions)
    here = wrapping(point)
    assert (here.stretch > 0).all()
    assert np.isfinite(here.bending).all()
