"""Rays through closed meshes are cut into the same intervals that a formula gives, whatever looks along them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from render.camera import look_at
from render.light_view import light_view
from render.mesh import Mesh
from render.peeling import layers
from render.shapes import plane, sphere, torus


def joined(one: Mesh, other: Mesh) -> Mesh:
    arrays = (np.concatenate([getattr(one, name), getattr(other, name)]) for name in ("positions", "normals"))
    rest = (np.concatenate([getattr(one, name), getattr(other, name)]) for name in ("tangents", "uv"))
    return Mesh(*arrays, *rest, np.concatenate([one.triangles, other.triangles + len(one.positions)]))


def moved(mesh: Mesh, way: tuple[float, float, float]) -> Mesh:
    return Mesh(mesh.positions + np.array(way), mesh.normals, mesh.tangents, mesh.uv, mesh.triangles)


@settings(max_examples=15, deadline=None)
@given(azimuth=st.floats(0, 6.3), height=st.floats(-0.9, 0.9), radius=st.floats(1e-2, 1e2))
def test_a_sphere_is_one_layer_as_thick_as_its_chords(azimuth, height, radius):
    level = np.sqrt(1 - height**2)
    eye = 4 * radius * np.array([level * np.cos(azimuth), level * np.sin(azimuth), height])
    camera = look_at(eye, (0, 0, 0), (24, 20), field_of_view_rad=0.6)
    found = list(layers(sphere(radius, shape=(48, 96)), camera))
    assert len(found) == 1
    image = np.column_stack([found[0].front.pixel % 24, found[0].front.pixel // 24, np.ones(len(found[0].entry))])
    rays = image @ np.linalg.inv(camera.matrix).T
    along = rays[:, 2] / np.linalg.norm(rays, axis=1) * 4 * radius
    chord = 2 * np.sqrt(np.maximum(radius**2 - (16 * radius**2 - along**2), 0.0))
    # The facets lie inside the sphere by a thousandth; near the outline that takes more off the chord.
    thick = chord > 0.6 * radius
    np.testing.assert_allclose((found[0].exit - found[0].entry)[thick], chord[thick], atol=0.01 * radius)


def test_a_torus_has_two_layers_along_its_plane_for_eye_and_light():
    mesh = torus(1.0, 0.3, shape=(24, 60))
    eye = look_at((40.0, 0.0, 0.0), (0, 0, 0), (40, 20), field_of_view_rad=0.03)
    light = light_view(np.array([1.0, 0.0, 0.0]), [mesh.positions], 40)
    for view in (eye, light):
        first, second = layers(mesh, view)
        assert set(second.front.pixel) <= set(first.front.pixel)
        assert (np.diff(first.front.pixel) > 0).all()
        np.testing.assert_array_equal(first.front.pixel, first.back.pixel)
        shared = np.isin(first.front.pixel, second.front.pixel)
        assert (first.entry < first.exit).all()
        assert (first.exit[shared] < second.entry).all()
        middle = np.abs(first.front.interpolate(mesh, mesh.positions)[:, 1]) < 0.1
        np.testing.assert_allclose((first.exit - first.entry)[middle].max(), 0.6, atol=0.02)


def test_what_lies_inside_or_behind_is_told_apart():
    """A sphere within a sphere changes no layer; one behind it is the next."""
    camera = look_at((8.0, 0.0, 0.0), (0, 0, 0), (30, 30), field_of_view_rad=0.3)
    large, small = sphere(1.0, shape=(24, 48)), sphere(0.4, shape=(24, 48))
    (alone,) = layers(large, camera)
    first, *_ = layers(joined(large, small), camera)
    np.testing.assert_array_equal(first.entry, alone.entry)
    first, second = layers(joined(large, moved(small, (-3.0, 0.0, 0.0))), camera)
    assert (second.entry > first.exit[np.isin(first.front.pixel, second.front.pixel)]).all()


@pytest.mark.parametrize("eye", [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)], ids=["in its hole", "inside its tube"])
def test_a_camera_amid_a_torus_sees_only_what_it_can_enter(eye):
    """In the hole it lies inside the bounding box, and outside the mesh."""
    camera = look_at(eye, (0.1, 2.0, 0.0), (30, 30), field_of_view_rad=1.2)
    for layer in layers(torus(1.0, 0.3, shape=(24, 60)), camera):
        assert (layer.entry > 0.0).all()
        assert (layer.exit > layer.entry).all()


def test_nothing_is_entered_where_nothing_lies_in_the_picture_or_nothing_closes():
    away = look_at((8.0, 0.0, 0.0), (16.0, 0.0, 0.0), (10, 10), field_of_view_rad=0.3)
    assert not list(layers(sphere(), away))
    above = look_at((0.1, 0.0, 8.0), (0.0, 0.0, 0.0), (10, 10), field_of_view_rad=0.3)
    assert not list(layers(plane(), above))
