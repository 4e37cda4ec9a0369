"""Mesh files as relit bodies: what is missing is made, what is amiss is told, what cannot be lit is refused."""

import numpy as np
import pytest
import trimesh

from processing.errors import GeometryError
from processing.lighting.directions import sample_directions
from processing.lighting.rays import Occluder
from processing.lighting.relighting import Relighting
from processing.lighting.self_visibility import self_visibility
from processing.lighting.surroundings import RelitBody
from processing.products.light_environment import Environment
from render.errors import MeshError
from render.mesh_file import load_mesh
from render.teapot import teapot
from service.relit_bodies import body_of

BOX = trimesh.creation.box()
ENDINGS = ["obj", "ply", "glb"]


def written(path, vertices=BOX.vertices, faces=BOX.faces):
    trimesh.Trimesh(vertices, faces, process=False).export(path)
    return path


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_file_without_normals_is_lit_as_its_facets_lie(tmp_path, ending):
    body, told = body_of(load_mesh(written(tmp_path / f"box.{ending}")))
    assert told == ()
    a, b, c = np.moveaxis(body.vertices[body.triangles], 1, 0)
    facet = np.cross(b - a, c - a)
    facet /= np.linalg.norm(facet, axis=1, keepdims=True)
    # Corners of a box are one vertex in the file: their normals lie between the sides.
    assert (np.einsum("mi,mki->mk", facet, body.normals[body.triangles]) > 0.57).all()


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_body_under_even_light_has_the_radiance_of_its_albedo(tmp_path, ending):
    """A box sees nothing of itself, so that each vertex gets all of the light over it, whatever the file was."""
    body, _ = body_of(load_mesh(written(tmp_path / f"box.{ending}")))
    sampled = sample_directions(9)
    relit = RelitBody(body, self_visibility(body, sampled, 0.0)[0], None)
    scene = Relighting([relit], sampled, Environment(np.ones((6, 8, 8, 3), np.float32)))
    flat = (np.abs(body.normals) > 0.99).any(axis=1)
    assert np.allclose(scene.frame().radiance[flat], 0.8, rtol=0.05)


@pytest.mark.parametrize("ending", ENDINGS)
def test_triangles_without_an_area_are_left_out_and_told(tmp_path, ending):
    vertices = np.concatenate([BOX.vertices, BOX.vertices[:1], [[9.0, 9.0, 9.0]]])
    faces = np.concatenate([BOX.faces, [[0, 0, 1], [9, 9, 9], [0, 8, 0]]])
    mesh = load_mesh(written(tmp_path / f"box.{ending}", vertices, faces))
    body, told = body_of(mesh)
    assert len(body.triangles) == 12
    assert len(body.vertices) == len(mesh.positions)  # what is drawn has the same numbers
    assert told == ("3 of 15 triangles have no area and are left out",)
    assert body.radius == pytest.approx(np.sqrt(3) / 2)


def test_vertices_that_are_there_twice_stay_and_share_their_normal(tmp_path):
    """A file of loose triangles (each with vertices of its own) is as smooth as one that shares them."""
    ball = trimesh.creation.icosphere(2)
    loose = written(tmp_path / "loose.ply", ball.vertices[ball.faces].reshape(-1, 3), np.arange(960).reshape(-1, 3))
    body, told = body_of(load_mesh(loose))
    assert told == ()
    assert len(body.vertices) >= 960
    assert ((body.normals * body.vertices).sum(axis=1) > 0.99).all()


def test_an_open_mesh_is_told_and_blocks_light_from_both_sides(tmp_path):
    body, told = body_of(load_mesh(written(tmp_path / "open.obj", BOX.vertices, BOX.faces[:-2])))
    assert [sentence.startswith("the mesh is open") for sentence in told] == [True]
    below, above = np.array([[0.1, 0.2, -2], [0.1, 0.2, 2]], np.float32)[:, None]
    occluder = Occluder(body.vertices, body.triangles)
    up = np.array([[0, 0, 1]], np.float32)
    assert occluder.blocks(below, up)[0]
    assert occluder.blocks(above, -up)[0]


def test_the_pieces_of_a_scene_stand_where_the_file_puts_them(tmp_path):
    scene = trimesh.Scene([BOX])
    scene.add_geometry(BOX, transform=trimesh.transformations.translation_matrix([5, 0, 0]))
    scene.export(tmp_path / "two.glb")
    body, told = body_of(load_mesh(tmp_path / "two.glb"))
    assert told == ()
    assert body.vertices[:, 0].max() == pytest.approx(5.5)


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("factors", [[0, 0, 0], [1, 0, 0]])
def test_meshes_without_an_area_are_refused_in_one_sentence(tmp_path, ending, factors):
    mesh = load_mesh(written(tmp_path / f"flat.{ending}", BOX.vertices * factors))
    with pytest.raises(GeometryError, match="no triangle has an area"):
        body_of(mesh)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_vertices_that_are_no_numbers_are_refused_with_the_file(tmp_path, bad):
    path = written(tmp_path / "bad.ply", np.where(np.arange(8)[:, None] == 3, bad, BOX.vertices))
    with pytest.raises(MeshError, match=r"bad\.ply"):
        load_mesh(path)


@pytest.mark.parametrize("detail", [0.35, 1.0])
def test_the_teapot_is_closed_and_its_normals_look_outward(detail):
    mesh = teapot(detail)
    body, told = body_of(mesh)
    assert told == ()
    assert len(body.triangles) == len(mesh.triangles)
    a, b, c = np.moveaxis(body.vertices[body.triangles], 1, 0)
    facet = np.cross(b - a, c - a)
    area = np.linalg.norm(facet, axis=1)
    cosine = np.einsum("mi,mki->mk", facet / area[:, None], body.normals[body.triangles]).min(axis=1)
    assert np.average(cosine < 0.5, weights=area) < 0.02
    assert np.einsum("mi,mi->m", a, np.cross(b, c)).sum() / 6 == pytest.approx(3.2, rel=0.05)
    assert body.vertices[:, 2].min() == pytest.approx(0, abs=0.005)


def test_spout_and_handle_leave_the_body_where_a_row_of_their_vertices_lies():
    """Vertices inside the body are dark; none of their triangles may show outside by more than a facet's depth."""
    mesh = teapot()
    body = mesh.positions[: 73 * 65].reshape(73, 65, 3)
    outline = np.stack([np.hypot(body[:, 0, 0], body[:, 0, 1]), body[:, 0, 2]], axis=1)[::-1]
    height = np.maximum.accumulate(outline[:, 1])
    for first, shape, rows in ((73 * 65, (49, 33), (2,)), (73 * 65 + 49 * 33, (53, 25), (2, 50))):
        tube = mesh.positions[first : first + shape[0] * shape[1]].reshape(*shape, 3)
        for row in rows:
            x, y, z = tube[row].T
            assert np.abs(np.hypot(x, y) - np.interp(z, height, outline[:, 0])).max() < 0.02
