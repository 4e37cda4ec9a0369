"""Bodies: what cannot be used is refused or left out, what is missing is made."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from processing.errors import GeometryError
from processing.lighting.triangle_body import triangle_body
from tests.processing.lighting.bodies import box, sphere, square


def test_normals_of_a_ball_point_outward():
    vertices, triangles = sphere(16)
    body = triangle_body(vertices, triangles)
    assert ((body.normals * vertices).sum(axis=1) > 0.99).all()
    assert not body.without_normal.any()


def test_corners_of_a_box_point_along_its_diagonals_whatever_its_triangles():
    """By angles, two triangles in a corner count as much as one."""
    vertices, triangles = box()
    assert np.allclose(triangle_body(vertices, triangles).normals, vertices / np.linalg.norm(vertices, axis=1)[:, None])


@given(st.floats(1e-6, 1e6), st.tuples(*[st.floats(-1, 1)] * 3))
def test_scale_and_place_do_not_matter(scale, place):
    vertices, triangles = box()
    body = triangle_body(scale * (vertices + place), triangles)
    assert np.allclose(body.normals, triangle_body(vertices, triangles).normals, atol=1e-6)
    assert body.radius == pytest.approx(scale * np.sqrt(3) / 2)
    assert np.allclose(body.centre, scale * np.array(place), atol=1e-9 * scale)


def test_triangles_without_an_area_are_left_out_and_lone_vertices_have_no_normal():
    vertices, triangles = square()
    vertices = np.concatenate([vertices, [[9, 9, 9], [0, 0, 0]]])
    body = triangle_body(vertices, np.concatenate([triangles, [[0, 0, 1], [4, 4, 4], [0, 5, 2]]]))
    assert len(body.triangles) == 2
    assert body.without_normal.tolist() == [False] * 4 + [True] * 2
    assert body.radius == pytest.approx(np.sqrt(2))  # the lone vertex far off casts no shadow


def test_given_normals_are_kept_where_they_can_be_used():
    vertices, triangles = square()
    given = np.array([[0, 3, 4], [0, 0, 0], [np.nan, 0, 1], [0, 0, -2.0]])
    expected = [[0, 0.6, 0.8], [0, 0, 1], [0, 0, 1], [0, 0, -1]]
    assert np.allclose(triangle_body(vertices, triangles, given).normals, expected)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda v, t: (np.where(v > 0, np.nan, v), t), "not finite"),
        (lambda v, t: (np.where(v > 0, np.inf, v), t), "not finite"),
        (lambda v, t: (v, t + 5), "name vertices"),
        (lambda v, t: (v, t - 1), "name vertices"),
        (lambda v, t: (0 * v, t), "no triangle has an area"),
        (lambda v, t: (v, t[:0]), "no triangle has an area"),
        (lambda v, t: (v[:, :2], t), "must be"),
        (lambda v, t: (v, t.astype(float)), "whole numbers"),
    ],
)
def test_what_cannot_be_used_is_refused(change, message):
    with pytest.raises(GeometryError, match=message):
        triangle_body(*change(*square()))


def test_normals_must_be_as_many_as_vertices():
    with pytest.raises(GeometryError, match="normals"):
        triangle_body(*square(), np.ones((3, 3)))
