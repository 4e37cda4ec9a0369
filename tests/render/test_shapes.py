"""Shapes are closed, face outward, and their frames are what the texture says."""

import numpy as np
import pytest

from render.arrays import unit
from render.frames import gradient_frames, vertex_frames
from render.mesh import Mesh, angle_weighted_normals, mesh_from_uv
from render.shapes import (
    MAP_FROM_RIG,
    captured_sphere,
    cylinder,
    knot,
    knot_surface,
    placed,
    plane,
    sphere,
    statue,
    torus,
    torus_surface,
    vase,
)

SHAPES = {
    "sphere": sphere(),
    "plane": plane(shape=(4, 5)),
    "torus": torus(),
    "cylinder": cylinder(),
    "knot": knot(),
    "vase": vase(),
    "statue": statue(),
}


@pytest.fixture(params=SHAPES)
def shape(request) -> Mesh:
    return SHAPES[request.param]


def interior_triangles(mesh: Mesh) -> np.ndarray:
    """Triangles whose texture is not squeezed to a point, as at the poles of a sphere."""
    across = np.linalg.norm(np.ptp(mesh.positions[mesh.triangles], axis=1), axis=1)
    return mesh.triangles[across > 0.3 * np.median(across)]


def test_frames_are_orthonormal_and_right_handed(shape):
    frames = vertex_frames(shape.normals, shape.tangents)
    np.testing.assert_allclose(frames @ np.swapaxes(frames, 1, 2), np.broadcast_to(np.eye(3), frames.shape), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(frames), 1.0, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "least_cosine"),
    [
        ("sphere", 0.97),
        ("plane", 1 - 1e-9),
        ("torus", 0.97),
        ("cylinder", 0.97),
        ("knot", 0.97),
        ("vase", 0.85),
        ("statue", 0.45),
    ],
)
def test_tangent_runs_along_u_and_binormal_against_v(name, least_cosine):
    """The texture's own derivatives agree with the analytic frame to what a triangle spans: 30 degrees at the lip.

    Where the statue turns in itself its texture is sheared, by up to 60 degrees.
    """
    shape = SHAPES[name]
    triangles = interior_triangles(shape)
    p0, p1, p2 = (shape.positions[triangles[:, k]] for k in range(3))
    jacobian = np.stack([shape.uv[triangles[:, k]] - shape.uv[triangles[:, 0]] for k in (1, 2)], axis=1)
    along = np.linalg.solve(jacobian, np.stack([p1 - p0, p2 - p0], axis=1))
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    frames = vertex_frames(shape.normals, shape.tangents)[triangles].mean(axis=1)
    assert (np.sum(along[:, 0] * frames[:, 0], axis=1) > least_cosine).all()
    assert (np.sum(along[:, 1] * frames[:, 1], axis=1) < -least_cosine).all()


def test_triangles_face_outward(shape):
    p0, p1, p2 = (shape.positions[shape.triangles[:, k]] for k in range(3))
    outward = np.sum(np.cross(p1 - p0, p2 - p0) * shape.normals[shape.triangles].sum(axis=1), axis=1)
    assert (outward > 0).all()


@pytest.mark.parametrize("name", ["sphere", "torus", "cylinder", "knot", "vase", "statue"])
def test_closed_shapes_have_no_border(name):
    mesh = SHAPES[name]
    _, place = np.unique(mesh.positions.round(9), axis=0, return_inverse=True)
    place = place.ravel()
    edges = np.concatenate([place[mesh.triangles[:, [a, b]]] for a, b in ((0, 1), (1, 2), (2, 0))])
    edges = edges[edges[:, 0] != edges[:, 1]]
    ordered = {tuple(edge) for edge in edges.tolist()}
    assert all((b, a) in ordered for a, b in ordered)


@pytest.mark.parametrize(
    ("mesh", "volume"),
    [
        (sphere(2.0), 4 / 3 * np.pi * 8.0),
        (torus(1.0, 0.4), 2 * np.pi**2 * 0.16),
        (cylinder(0.4, 1.5), np.pi * 0.16 * 1.5),
    ],
)
def test_volume_is_that_of_the_smooth_surface(mesh, volume):
    """A mesh inscribed in a curved surface loses the segments' sagitta: under 0.5 % at these steps."""
    a, b, c = (mesh.positions[mesh.triangles[:, k]] for k in range(3))
    assert np.sum(a * np.cross(b, c)) / 6 == pytest.approx(volume, rel=5e-3)


def test_torus_texture_closes_after_whole_tiles():
    mesh = torus(tiles=(5.0, 2.0), shape=(16, 24))
    u = mesh.uv[:, 0].reshape(17, 25)
    v = mesh.uv[:, 1].reshape(17, 25)
    positions = mesh.positions.reshape(17, 25, 3)
    np.testing.assert_allclose(positions[:, 0], positions[:, -1], atol=1e-12)
    np.testing.assert_allclose(positions[0], positions[-1], atol=1e-12)
    np.testing.assert_allclose(u[:, -1] - u[:, 0], 5.0)
    np.testing.assert_allclose(v[-1] - v[0], 2.0)


def test_cylinder_has_one_length_of_a_tile_on_side_and_ends():
    """World length of one tile along u and along v, triangle by triangle; the side's chords are 0.02 % short."""
    mesh = cylinder(0.5, 2.0, tiles=(np.pi, 2.0))
    p0, p1, p2 = (mesh.positions[mesh.triangles[:, k]] for k in range(3))
    jacobian = np.stack([mesh.uv[mesh.triangles[:, k]] - mesh.uv[mesh.triangles[:, 0]] for k in (1, 2)], axis=1)
    along = np.linalg.solve(jacobian, np.stack([p1 - p0, p2 - p0], axis=1))
    np.testing.assert_allclose(np.linalg.norm(along, axis=2), 1.0, atol=1e-3)


def test_knot_is_even_along_its_length_and_closes():
    """The middle of the tube goes on at one speed, to the spline's error, and comes back to where it began."""
    surface = knot_surface()
    u, v = np.linspace(0.0, 1.0, 801), np.zeros(801)
    middle = surface(u, v)[0] - 0.22 * surface(u, v)[1]
    speed = np.linalg.norm(np.diff(middle, axis=0), axis=1)
    np.testing.assert_allclose(speed, speed.mean(), rtol=1e-3)
    for first, last in zip(surface(u[:1], v[:1]), surface(u[-1:], v[-1:]), strict=True):
        np.testing.assert_allclose(first, last, atol=1e-9)


def test_knot_has_room_between_its_strands():
    """Points of the middle that are farther along than half a turn of the tube lie over a diameter apart."""
    surface = knot_surface()
    u, v = np.linspace(0.0, 1.0, 400, endpoint=False), np.zeros(400)
    middle = surface(u, v)[0] - 0.22 * surface(u, v)[1]
    apart = np.linalg.norm(middle[:, None] - middle, axis=2)
    length = np.linalg.norm(np.diff(middle, axis=0), axis=1).mean()
    steps = np.abs(np.arange(400)[:, None] - np.arange(400))
    assert apart[np.minimum(steps, 400 - steps) * length > np.pi * 0.22].min() > 2 * 0.22


def test_knot_normals_are_those_of_the_surface():
    """Perpendicular to differences of the surface both ways."""
    surface = knot_surface(turns=(3, 4), tube_radius=0.1)
    u, v = np.random.default_rng(7).uniform(0.0, 1.0, (2, 500))
    positions, normals, along = surface(u, v)
    around = surface(u, v + 1e-5)[0] - positions
    assert np.abs(np.sum(unit(normals) * unit(along), axis=1)).max() < 1e-6
    assert np.abs(np.sum(unit(normals) * unit(around), axis=1)).max() < 1e-3


def test_placed_surface_is_the_moved_one():
    world_from_body = np.array([[0, -1, 0, 1.0], [0, 0, -1, 2.0], [1, 0, 0, 3.0], [0, 0, 0, 1.0]])
    u, v = np.random.default_rng(7).uniform(0.0, 1.0, (2, 20))
    here, there = torus_surface()(u, v), placed(torus_surface(), world_from_body)(u, v)
    np.testing.assert_allclose(there[0], np.column_stack([1 - here[0][:, 1], 2 - here[0][:, 2], 3 + here[0][:, 0]]))
    for before, after in zip(here[1:], there[1:], strict=True):
        np.testing.assert_allclose(after, np.column_stack([-before[:, 1], -before[:, 2], before[:, 0]]))


def test_vase_has_more_than_ten_thousand_triangles_and_stands_on_the_ground():
    mesh = SHAPES["vase"]
    assert len(mesh.triangles) > 10_000
    assert mesh.positions[:, 2].min() == pytest.approx(0.0, abs=0.03)


def test_statue_is_as_large_as_a_scan_and_of_no_symmetry():
    """84 668 triangles, no two of its vertices mirror images of each other beside the axis."""
    mesh = SHAPES["statue"]
    assert len(mesh.triangles) == 84_668
    ring = mesh.positions[np.abs(mesh.positions[:, 2] - 0.5) < 0.02]
    for mirror in ([-1, 1, 1], [1, -1, 1]):
        distance = np.linalg.norm(ring[:, None] * mirror - ring, axis=2).min(axis=1)
        assert np.median(distance) > 0.005


def test_plane_lies_like_a_captured_sample():
    """Texel (0, 0) is at -X, +Y of the sample; t = +X, b = +Y, n = +Z."""
    mesh = plane(2.0)
    corner = mesh.positions[np.argmin(mesh.uv.sum(axis=1))]
    np.testing.assert_allclose(corner, [-1.0, 1.0, 0.0])
    np.testing.assert_allclose(vertex_frames(mesh.normals, mesh.tangents)[0], np.eye(3), atol=1e-12)


@pytest.mark.parametrize("name", ["sphere", "torus"])
def test_tangents_from_texture_derivatives_are_the_analytic_ones(name):
    """Averaged per vertex, the error is of second order in the angle of a segment (3 degrees)."""
    mesh = SHAPES[name]
    derived = mesh_from_uv(mesh.positions, mesh.normals, mesh.uv, mesh.triangles)
    assert len(derived.positions) <= len(mesh.positions)
    analytic = {
        tuple(p): t for p, t in zip(np.hstack([mesh.positions, mesh.uv]).round(9).tolist(), mesh.tangents, strict=True)
    }
    pairs = [
        (tangent[:3], analytic[tuple(row)][:3])
        for row, tangent, normal in zip(
            np.hstack([derived.positions, derived.uv]).round(9).tolist(), derived.tangents, derived.normals, strict=True
        )
        if abs(normal[2]) < 0.99 or name == "torus"
    ]
    cosines = np.array([np.dot(a, b) for a, b in pairs])
    assert cosines.min() > np.cos(np.radians(3.0))
    assert (derived.tangents[:, 3] == 1.0).all()


def test_angle_weighted_normals_are_those_of_the_sphere():
    mesh = sphere(shape=(32, 64))
    inside = np.abs(mesh.normals[:, 1]) > 0.05  # away from the seam, whose vertices see one side only
    inside &= np.abs(mesh.normals[:, 2]) < 0.95
    error = np.linalg.norm(unit(angle_weighted_normals(mesh.positions, mesh.triangles)) - mesh.normals, axis=1)
    assert error[inside].max() < 0.01


def test_gradient_frames_follow_the_captured_sphere():
    """From the capture's camera: u to the right, v downward, t to the right, b upward, n toward the camera."""
    uv, frames = gradient_frames(np.array([[1.0, 0.0, 0.0]]), MAP_FROM_RIG)
    np.testing.assert_allclose(uv, [[0.5, 0.5]])
    np.testing.assert_allclose(frames[0], [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]], atol=1e-12)
    right_and_low = np.array([[1.0, 0.5, -0.25]])
    uv, _ = gradient_frames(right_and_low, MAP_FROM_RIG)
    # p = 0.5, q = 0.25 there: the map spans [-1, 1].
    np.testing.assert_allclose(uv, [[0.75, 0.625]])


def test_gradient_frames_are_right_handed_and_orthonormal_everywhere():
    mesh = captured_sphere()
    uv, frames = gradient_frames(mesh.normals, MAP_FROM_RIG)
    np.testing.assert_allclose(frames @ np.swapaxes(frames, 1, 2), np.broadcast_to(np.eye(3), frames.shape), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(frames), 1.0, atol=1e-9)
    assert (uv >= 0).all()
    assert (uv <= 1).all()


def test_gradient_map_is_continuous_over_its_border():
    """On both sides of p = 1 the texel and the frame are the same, so the residual has no step there."""
    normals = np.array([[1.0, 1.0 - 1e-9, 0.0], [1.0, 1.0 + 1e-9, 0.0]])
    uv, frames = gradient_frames(normals, MAP_FROM_RIG)
    np.testing.assert_allclose(uv[0], uv[1], atol=1e-8)
    np.testing.assert_allclose(frames[0], frames[1], atol=1e-8)
