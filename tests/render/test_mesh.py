"""Meshes check their arrays, and tangents follow the texture even where it is mirrored or degenerate."""

import numpy as np
import pytest

from render.errors import MeshError
from render.frames import vertex_frames
from render.mesh import Mesh, mesh_from_uv, perpendicular

QUAD = np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, -1.0, 0.0], [1.0, -1.0, 0.0]])
UP = np.broadcast_to([0.0, 0.0, 1.0], (4, 3))
TRIANGLES = np.array([[0, 2, 1], [1, 2, 3]], dtype=np.int32)
UPRIGHT = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])


def test_upright_texture_gives_the_sample_frame():
    mesh = mesh_from_uv(QUAD, UP, UPRIGHT, TRIANGLES)
    frames = vertex_frames(mesh.normals, mesh.tangents)
    np.testing.assert_allclose(frames, np.broadcast_to(np.eye(3), (4, 3, 3)), atol=1e-12)


def test_turned_texture_turns_the_frame():
    quarter = np.column_stack([UPRIGHT[:, 1], 1 - UPRIGHT[:, 0]])
    frames = vertex_frames(*_frame_arrays(mesh_from_uv(QUAD, UP, quarter, TRIANGLES)))
    np.testing.assert_allclose(frames[:, 0], np.broadcast_to([0.0, -1.0, 0.0], (4, 3)), atol=1e-12)
    np.testing.assert_allclose(frames[:, 1], np.broadcast_to([1.0, 0.0, 0.0], (4, 3)), atol=1e-12)


def test_mirrored_texture_has_a_left_handed_frame():
    mirrored = np.column_stack([1 - UPRIGHT[:, 0], UPRIGHT[:, 1]])
    frames = vertex_frames(*_frame_arrays(mesh_from_uv(QUAD, UP, mirrored, TRIANGLES)))
    np.testing.assert_allclose(frames[:, 0], np.broadcast_to([-1.0, 0.0, 0.0], (4, 3)), atol=1e-12)
    np.testing.assert_allclose(frames[:, 1], np.broadcast_to([0.0, 1.0, 0.0], (4, 3)), atol=1e-12)


def test_vertices_between_mirrored_and_unmirrored_texture_are_split():
    positions = np.array([[-1.0, 0, 0], [0, 1, 0], [0, -1, 0], [1, 0, 0]])
    folded = np.array([[0.0, 0.5], [1.0, 0.0], [1.0, 1.0], [0.0, 0.5]])
    mesh = mesh_from_uv(positions, UP, folded, np.array([[0, 2, 1], [1, 2, 3]], dtype=np.int32))
    assert len(mesh.positions) == 6
    assert sorted(mesh.tangents[:, 3].tolist()) == [-1.0] * 3 + [1.0] * 3
    np.testing.assert_allclose(mesh.tangents[:, 0], mesh.tangents[:, 3], atol=1e-12)


def test_texture_without_area_still_has_orthonormal_frames():
    mesh = mesh_from_uv(QUAD, UP, np.zeros((4, 2)), TRIANGLES)
    frames = vertex_frames(mesh.normals, mesh.tangents)
    np.testing.assert_allclose(frames @ np.swapaxes(frames, 1, 2), np.broadcast_to(np.eye(3), (4, 3, 3)), atol=1e-12)


def test_perpendicular_of_a_parallel_vector_is_some_perpendicular():
    normals = np.eye(3)
    result = perpendicular(normals, normals)
    np.testing.assert_allclose(np.sum(result * normals, axis=1), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(result, axis=1), 1.0)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"uv": np.zeros((3, 2))}, "uv must be"),
        ({"normals": np.full((4, 3), np.nan)}, "normals must be"),
        ({"triangles": np.zeros((0, 3), dtype=np.int32)}, "no triangles"),
        ({"triangles": np.array([[0, 1, 4]], dtype=np.int32)}, "name vertices 0 to 4 of 4"),
    ],
)
def test_arrays_that_disagree_are_refused(change, says):
    arrays = {
        "positions": QUAD,
        "normals": UP,
        "tangents": np.tile([1.0, 0, 0, 1], (4, 1)),
        "uv": UPRIGHT,
        "triangles": TRIANGLES,
    }
    with pytest.raises(MeshError, match=says):
        Mesh(**(arrays | change))


def _frame_arrays(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    return mesh.normals, mesh.tangents
