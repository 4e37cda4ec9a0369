"""The reference rasteriser agrees with rays cast by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from render.camera import Camera, look_at
from render.mesh import Mesh
from render.rasteriser import rasterise
from render.scene import framed
from render.shapes import plane, sphere, torus, vase


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
    """No pixel shows something that lies behind a vertex which falls into it."""
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


@pytest.mark.parametrize("mesh", [plane(), vase(), torus()], ids=["plane", "vase", "torus"])
@pytest.mark.parametrize("size", [(80, 60), (50, 90)])
def test_framed_mesh_stands_in_the_middle_and_fills_the_window(mesh, size):
    """88 % of one side, the same margin on both sides, each to a pixel."""
    camera = framed(mesh, size, azimuth_rad=0.7, elevation_rad=0.6)
    points = camera.in_camera(mesh.positions) @ camera.matrix.T
    image_px = points[:, :2] / points[:, 2:]
    low, high = image_px.min(axis=0), image_px.max(axis=0)
    np.testing.assert_allclose(low + high, np.array(size) - 1, atol=1.0)
    assert ((high - low) / size).max() == pytest.approx(0.88, abs=1 / min(size))


def test_framed_mesh_may_be_seen_from_straight_above():
    camera = framed(plane(), (40, 40), azimuth_rad=0.0, elevation_rad=np.pi / 2)
    assert len(rasterise(plane(), camera).pixel) == pytest.approx((0.88 * 40) ** 2, rel=0.1)
