"""The reference rasteriser agrees with rays cast by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from render.camera import Camera, look_at
from render.mesh import Mesh
from render.rasteriser import rasterise
from render.scene import framed
from render.shapes import plane, sphere, torus


def triangle(corners: np.ndarray) -> Mesh:
    """One triangle, whatever its frame."""
    return Mesh(
        corners,
        np.tile([0.0, 0.0, 1.0], (3, 1)),
        np.tile([1.0, 0.0, 0.0, 1.0], (3, 1)),
        np.zeros((3, 2)),
        np.array([[0, 1, 2]], dtype=np.int32),
    )


def hits(corners: np.ndarray, camera: Camera) -> np.ndarray:
    """Which pixels' rays meet the front of the triangle before the camera, (h, w), by Moeller and Trumbore 1997."""
    width, height = camera.size
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(camera.matrix).T
    a, b, c = camera.in_camera(corners)
    across = np.cross(rays, c - a)
    determinant = across @ (b - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        first = across @ -a / determinant
        turned = np.cross(-a, b - a)
        second = rays @ turned / determinant
        distance = (c - a) @ turned / determinant
        return (determinant > 0) & (first >= 0) & (second >= 0) & (first + second <= 1) & (distance > 0)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_coverage_is_what_the_rays_hit(seed):
    """Also for triangles that reach behind the camera; pixels within rounding of an edge may differ."""
    rng = np.random.default_rng(seed)
    camera = look_at((0.0, -3.0, 0.5), (0.0, 0.0, 0.0), (31, 23), field_of_view_rad=0.9)
    corners = rng.normal(size=(3, 3)) * [2.0, 3.0, 2.0]
    fragments = rasterise(triangle(corners), camera)
    covered = np.zeros(31 * 23, dtype=bool)
    covered[fragments.pixel] = True
    assert (covered.reshape(23, 31) != hits(corners, camera)).sum() <= 1


def test_barycentric_coordinates_are_those_of_space():
    """A steep plane: the interpolated position lies on the ray of its pixel."""
    mesh = plane(2.0)
    camera = look_at((0.3, -2.0, 0.6), (0.0, 0.0, 0.0), (60, 40), field_of_view_rad=0.8)
    fragments = rasterise(mesh, camera)
    points = camera.in_camera(fragments.interpolate(mesh, mesh.positions))
    image_px = points @ camera.matrix.T
    image_px = image_px[:, :2] / image_px[:, 2:]
    np.testing.assert_allclose(image_px[:, 0], fragments.pixel % 60, atol=1e-9)
    np.testing.assert_allclose(image_px[:, 1], fragments.pixel // 60, atol=1e-9)
    np.testing.assert_allclose(points[:, 2], fragments.depth, atol=1e-9)


@pytest.mark.parametrize("mesh", [sphere(shape=(24, 48)), torus(shape=(24, 48))], ids=["sphere", "torus"])
def test_each_pixel_shows_the_nearest_surface(mesh):
    """No vertex that faces the eye is hidden by something that lies behind it."""
    camera = framed(mesh, (120, 120), azimuth_rad=0.3, elevation_rad=0.5)
    fragments = rasterise(mesh, camera)
    assert (np.diff(fragments.pixel) > 0).all()
    depth = np.full(120 * 120, np.inf)
    depth[fragments.pixel] = fragments.depth
    points = camera.in_camera(mesh.positions)
    # Vertices seen face on: near the outline the surface recedes by more than a pixel's width within a pixel.
    toward_eye = np.sum(mesh.normals * (camera.eye - mesh.positions), axis=1)
    facing = toward_eye > 0.5 * np.linalg.norm(camera.eye - mesh.positions, axis=1)
    image_px = points @ camera.matrix.T
    at = np.round(image_px[:, :2] / image_px[:, 2:]).astype(int)[facing]
    assert facing.sum() > 100
    # A pixel is 0.02 wide there, and recedes by less than twice that.
    assert (depth[at[:, 1] * 120 + at[:, 0]] < points[facing, 2] + 0.04).all()


def test_back_faces_are_not_drawn():
    camera = look_at((0.0, -0.5, -3.0), (0.0, 0.0, 0.0), (20, 20), field_of_view_rad=0.5)
    assert len(rasterise(plane(), camera).pixel) == 0


def test_nothing_in_sight_is_an_empty_picture():
    camera = look_at((0.0, -3.0, 1.0), (0.0, -6.0, 1.0), (20, 20), field_of_view_rad=0.5)
    assert len(rasterise(plane(), camera).pixel) == 0


def test_framed_mesh_fills_the_window_and_stays_inside():
    mesh = torus(shape=(24, 48))
    camera = framed(mesh, (80, 60), azimuth_rad=0.7, elevation_rad=0.6)
    pixel = rasterise(mesh, camera).pixel
    column, row = pixel % 80, pixel // 80
    assert column.min() > 1
    assert column.max() < 78
    assert row.min() > 1
    assert row.max() < 58
    # 88 % of the window leaves 6 % on either side: the torus touches that on one side, to a pixel and a half.
    margins_px = [column.min(), 79 - column.max(), row.min(), 59 - row.max()]
    assert min(margins_px) <= 0.06 * 80 + 1.5
