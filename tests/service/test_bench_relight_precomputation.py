"""The furnished room, and the sizes of its codes."""

import numpy as np
import pytest

from processing.lighting import coding
from processing.lighting.directions import sample_directions
from processing.lighting.field import trace_field
from processing.lighting.shells import ShellPlan
from tests.benchmarks.relights import precomputation
from tests.benchmarks.yardsticks.furniture import FULL, QUICK, furniture


@pytest.mark.parametrize("vertices", [QUICK, FULL])
def test_the_room_has_as_many_vertices_as_asked_for(vertices):
    assert sum(len(piece.body.vertices) for piece in furniture(vertices)) == pytest.approx(vertices, rel=0.03)


def test_normals_look_to_the_side_that_triangles_do():
    """A tube of eight sides: its normals are at most half a side's angle off, a cosine of 0.92."""
    for piece in furniture(QUICK):
        a, b, c = np.moveaxis(piece.body.vertices[piece.body.triangles], 1, 0)
        face = np.cross(b - a, c - a)
        face /= np.linalg.norm(face, axis=1, keepdims=True)
        assert (np.einsum("mi,mki->mk", face, piece.body.normals[piece.body.triangles]) > 0.9).all()


def test_pieces_stand_on_the_floor_within_the_room():
    for piece in furniture(QUICK):
        vertices = piece.body.vertices + piece.place
        assert (np.abs(vertices[:, :2]) <= 2.0).all()
        assert vertices[:, 2].min() == pytest.approx(1e-3 if piece.outline is None else 0, abs=1e-9)


def test_sizes_are_5_and_17_bits_of_all_nodes():
    (lamp,) = (piece for piece in furniture(QUICK) if piece.name == "lamp")
    plan = ShellPlan(3).around(lamp.body.centre, lamp.body.radius)
    field, _ = trace_field(lamp.body, sample_directions(7), plan)
    by_height, by_index, nodes = precomputation._field_sizes(field)
    assert nodes == round(field.mean_cut * len(field.shells))
    assert by_height == pytest.approx(5 * nodes / 8, abs=3)
    assert by_index == pytest.approx(17 * nodes / 8, abs=3)


def test_bytes_of_a_vertex_node_are_those_of_its_code():
    cuts = coding.from_index_form(coding._pack(np.full(100, 2, np.uint32), 17), 100, 7)
    assert len(coding.valued_height_form(cuts)) == precomputation.NODE_BYTES[0] * 100
