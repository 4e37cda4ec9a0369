"""Meshes from OBJ, PLY, GLB and whatever else trimesh reads."""

from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from render.arrays import Float64, Int32, Rows, dot, unit
from render.errors import MeshError
from render.mesh import Mesh, angle_weighted_normals, mesh_from_uv, perpendicular

# trimesh hands on only what is named with an underscore: our files have both names for the same numbers.
_NORMAL, _TANGENT = "_NORMAL", "_TANGENT"
# Vertices at one place share a smooth normal unless theirs lies farther than 37 degrees from it: then it is an edge.
_SMOOTH_COSINE = 0.8


def load_mesh(path: Path, *, tiles: tuple[float, float] = (1.0, 1.0)) -> Mesh:
    """A mesh from a file, its texture repeated `tiles` times.

    Without texture coordinates in the file the texture is laid on from the six sides of the bounding box. Normals and
    tangents follow the facets and the texture, unless `save_mesh` wrote the file. A closed mesh that is wound inside
    out is turned. Raises MeshError where the file is missing, unreadable or holds no triangles.
    """
    loaded = _read(path)
    positions = np.asarray(loaded.vertices, dtype=np.float64)
    triangles = np.asarray(loaded.faces, dtype=np.int32)
    if not len(triangles) or not np.isfinite(positions).all():
        raise MeshError(f"{path}: holds no triangles with finite corners")
    if _signed_volume(positions, triangles) < 0.0:
        triangles = np.ascontiguousarray(triangles[:, ::-1])
    normals = _smooth_normals(positions, triangles)
    uv = getattr(loaded.visual, "uv", None)
    if uv is None or len(uv) != len(positions):
        positions, normals, uv, triangles = _box_mapping(positions, normals, triangles)
    else:
        # trimesh hands out v upward whatever the file format says; ours runs downward.
        uv = np.column_stack([uv[:, 0], 1.0 - uv[:, 1]])
        tangents = np.asarray(loaded.vertex_attributes.get(_TANGENT, ()), dtype=np.float64)
        if tangents.shape == (len(positions), 4):
            # Charts cut such a mesh anywhere: normals made anew would show an edge where it is only cut.
            normals = unit(np.asarray(loaded.vertex_attributes[_NORMAL]))
            frames = np.column_stack([perpendicular(tangents[:, :3], normals), np.sign(tangents[:, 3])])
            return Mesh(positions, normals, frames, uv * np.asarray(tiles), triangles)
    return mesh_from_uv(positions, normals, np.asarray(uv * np.asarray(tiles), dtype=np.float64), triangles)


def save_mesh(path: Path, mesh: Mesh) -> None:
    """Write a GLB with normals, texture coordinates and tangents, which keep the frame that a material was made in."""
    uv = np.column_stack([mesh.uv[:, 0], 1.0 - mesh.uv[:, 1]])
    written = trimesh.Trimesh(
        mesh.positions,
        mesh.triangles,
        vertex_normals=mesh.normals,
        vertex_attributes={_TANGENT: mesh.tangents.astype(np.float32)},
        visual=trimesh.visual.TextureVisuals(uv=uv),
        process=False,
    )
    content = trimesh.Scene(written).export(file_type="glb", include_normals=True, tree_postprocessor=_name_frames)
    path.write_bytes(content)


def _name_frames(tree: dict[str, Any]) -> None:
    """Name normals and tangents both as glTF does and as trimesh reads them."""
    for mesh in tree["meshes"]:
        for primitive in mesh["primitives"]:
            attributes = primitive["attributes"]
            attributes["TANGENT"], attributes[_NORMAL] = attributes[_TANGENT], attributes["NORMAL"]


def _read(path: Path) -> trimesh.Trimesh:
    """The file as one mesh; every failure of the reader is a MeshError."""
    if not path.is_file():
        raise MeshError(f"{path}: no such file")
    try:
        loaded = trimesh.load_mesh(path, process=False)
    except Exception as error:
        raise MeshError(f"{path}: not a mesh that can be read: {error}") from error
    if not hasattr(loaded, "faces"):
        raise MeshError(f"{path}: holds no triangles")
    return loaded


def _signed_volume(positions: Rows, triangles: Int32) -> float:
    """Volume of a closed mesh, negative when it is inside out; 0 for an open one, whose winding is taken as it is."""
    _, place = np.unique(positions, axis=0, return_inverse=True)
    edges = np.concatenate([place.ravel()[triangles[:, [a, b]]] for a, b in ((0, 1), (1, 2), (2, 0))])
    ordered, averted = (np.unique(ends.astype(np.int64) @ [len(positions), 1]) for ends in (edges, edges[:, ::-1]))
    if not np.array_equal(ordered, averted):
        return 0.0
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    return float(np.sum(a * np.cross(b, c)) / 6.0)


def _smooth_normals(positions: Rows, triangles: Int32) -> Float64:
    """Vertex normals averaged over all vertices at one place, but for edges."""
    own = angle_weighted_normals(positions, triangles)
    _, place = np.unique(positions, axis=0, return_inverse=True)
    shared = np.zeros((int(place.max()) + 1, 3))
    np.add.at(shared, place.ravel(), own)
    own, together = unit(own), unit(shared)[place.ravel()]
    return np.where(dot(own, together) > _SMOOTH_COSINE, together, own)


def _box_mapping(positions: Rows, normals: Rows, triangles: Int32) -> tuple[Float64, Float64, Float64, Int32]:
    """Texture coordinates from the side of the bounding box that each triangle faces; seams split their vertices."""
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    face = np.cross(b - a, c - a)
    axis = np.argmax(np.abs(face), axis=1)
    side = 2 * axis + (np.take_along_axis(face, axis[:, None], axis=1)[:, 0] < 0)
    split, corner = np.unique(6 * triangles.astype(np.int64) + side[:, None], return_inverse=True)
    vertex, side = split // 6, split % 6
    low = positions.min(axis=0)
    local = (positions[vertex] - low) / max(float((positions.max(axis=0) - low).max()), 1e-12)
    # Right and up as seen from outside, for +X, -X, +Y, -Y, +Z, -Z.
    right = np.array([[0, 1, 0], [0, -1, 0], [-1, 0, 0], [1, 0, 0], [1, 0, 0], [-1, 0, 0]])[side]
    up = np.array([[0, 0, 1], [0, 0, 1], [0, 0, 1], [0, 0, 1], [0, 1, 0], [0, 1, 0]])[side]
    uv = np.hstack([dot(right, local) + (right.min(axis=1, keepdims=True) < 0), 1.0 - dot(up, local)])
    return positions[vertex], normals[vertex], uv, corner.reshape(triangles.shape).astype(np.int32)
