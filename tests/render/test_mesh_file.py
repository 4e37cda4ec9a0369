"""Mesh files come in with texture downward, normals smooth, and one clear error for what is no mesh."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from render.errors import MeshError
from render.frames import vertex_frames
from render.mesh_file import load_mesh, save_mesh
from render.shapes import sphere, torus

QUAD_OBJ = """\
v -1 1 0
v 1 1 0
v -1 -1 0
v 1 -1 0
vt 0 1
vt 1 1
vt 0 0
vt 1 0
f 1/1 3/3 2/2
f 2/2 3/3 4/4
"""


def textured(mesh) -> trimesh.Trimesh:
    """One of our meshes as trimesh has it: v upward."""
    uv = np.column_stack([mesh.uv[:, 0], 1 - mesh.uv[:, 1]])
    return trimesh.Trimesh(mesh.positions, mesh.triangles, visual=trimesh.visual.TextureVisuals(uv=uv), process=False)


def by_place(mesh, rows: np.ndarray) -> dict[tuple, np.ndarray]:
    """Rows per position and texture coordinate."""
    keys = np.hstack([mesh.positions, mesh.uv]).round(4).tolist()
    return {tuple(key): row for key, row in zip(keys, rows, strict=True)}


def test_obj_with_texture_has_the_sample_frame(tmp_path):
    path = tmp_path / "quad.obj"
    path.write_text(QUAD_OBJ)
    mesh = load_mesh(path, tiles=(2.0, 3.0))
    np.testing.assert_allclose(mesh.uv[np.argmin(mesh.positions @ [1, -1, 0])], [0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(mesh.uv.max(axis=0), [2.0, 3.0])
    frames = vertex_frames(mesh.normals, mesh.tangents)
    np.testing.assert_allclose(frames, np.broadcast_to(np.eye(3), frames.shape), atol=1e-9)


@pytest.mark.parametrize("suffix", ["obj", "glb"])
def test_torus_comes_back_as_it_was_written(tmp_path, suffix):
    """Positions, texture and frames survive the file, normals to less than a segment of 15 degrees."""
    original = torus(shape=(24, 48), tiles=(1.0, 1.0))
    path = tmp_path / f"torus.{suffix}"
    textured(original).export(path)
    loaded = load_mesh(path)
    assert len(loaded.triangles) == len(original.triangles)
    before = by_place(original, vertex_frames(original.normals, original.tangents))
    after = by_place(loaded, vertex_frames(loaded.normals, loaded.tangents))
    shared = before.keys() & after.keys()
    assert len(shared) > 0.95 * len(before)
    cosines = [np.sum(before[key] * after[key], axis=1).min() for key in shared]
    assert min(cosines) > np.cos(np.radians(15.0))


def test_ply_without_texture_gets_it_from_the_sides_of_its_box(tmp_path):
    path = tmp_path / "ball.ply"
    ball = sphere(shape=(24, 48))
    trimesh.Trimesh(ball.positions, ball.triangles, process=True).export(path)
    mesh = load_mesh(path)
    assert (mesh.uv >= -1e-9).all()
    assert (mesh.uv <= 1 + 1e-9).all()
    np.testing.assert_allclose(mesh.normals, mesh.positions, atol=0.02)
    assert (mesh.tangents[:, 3] == 1.0).all()
    # Nowhere is the texture stretched by more than the slope at a cube's corner direction, sqrt(3), and a segment.
    corners = mesh.triangles
    edge = mesh.positions[corners[:, 1]] - mesh.positions[corners[:, 0]]
    across = mesh.uv[corners[:, 1]] - mesh.uv[corners[:, 0]]
    assert (np.linalg.norm(edge, axis=1) <= 2.0 * 2.1 * np.linalg.norm(across, axis=1) + 1e-9).all()


def test_box_keeps_its_edges(tmp_path):
    path = tmp_path / "box.stl"
    trimesh.creation.box((1.0, 2.0, 3.0)).export(path)
    mesh = load_mesh(path)
    assert (np.abs(mesh.normals).max(axis=1) > 0.999).all()


def test_closed_mesh_that_is_inside_out_is_turned(tmp_path):
    path = tmp_path / "inside_out.ply"
    ball = sphere(shape=(12, 24))
    closed = trimesh.Trimesh(ball.positions, ball.triangles, process=True)
    closed.merge_vertices(digits_vertex=8)
    closed.faces = closed.faces[:, ::-1]
    closed.export(path)
    mesh = load_mesh(path)
    assert (np.sum(mesh.normals * mesh.positions, axis=1) > 0.9).all()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("junk.obj", b"\x00\x01 not a mesh"),
        ("empty.ply", b""),
        ("cut.glb", b"glTF\x02\x00\x00\x00\xff\xff"),
        ("picture.png", b"\x89PNG\r\n\x1a\n"),
        ("points.obj", b"v 0 0 0\nv 1 0 0\n"),
    ],
)
def test_what_is_no_mesh_is_one_clear_error(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(MeshError, match=name):
        load_mesh(path)


def test_missing_file_is_one_clear_error(tmp_path):
    with pytest.raises(MeshError, match=r"nowhere\.obj: no such file"):
        load_mesh(tmp_path / "nowhere.obj")


def test_written_mesh_keeps_its_frames(tmp_path):
    """Also tangents that the texture does not have: here a third of a turn from it, mirrored on one half."""
    original = torus(shape=(24, 48), tiles=(1.0, 1.0))
    t, n = original.tangents[:, :3], original.normals
    turned = np.cos(2.1) * t + np.sin(2.1) * np.cross(n, t)
    sign = np.where(original.positions[:, 2:] > 0, 1.0, -1.0)
    written = replace(original, tangents=np.hstack([turned, sign]))
    save_mesh(tmp_path / "torus.glb", written)
    loaded = load_mesh(tmp_path / "torus.glb")
    np.testing.assert_array_equal(loaded.triangles, written.triangles)
    np.testing.assert_allclose(loaded.uv, written.uv, atol=1e-6)
    np.testing.assert_array_equal(loaded.tangents[:, 3], written.tangents[:, 3])
    np.testing.assert_allclose(loaded.normals, written.normals, atol=1e-6)
    np.testing.assert_allclose(loaded.tangents[:, :3], turned, atol=1e-6)


def test_written_mesh_names_its_tangents_as_gltf_does(tmp_path):
    save_mesh(tmp_path / "torus.glb", torus(shape=(4, 6)))
    content = (tmp_path / "torus.glb").read_bytes()
    header = json.loads(content[20 : 20 + int.from_bytes(content[12:16], "little")])
    attributes = header["meshes"][0]["primitives"][0]["attributes"]
    assert {"POSITION", "NORMAL", "TEXCOORD_0", "TANGENT"} <= attributes.keys()
    assert header["accessors"][attributes["TANGENT"]]["type"] == "VEC4"
