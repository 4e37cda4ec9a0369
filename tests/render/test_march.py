"""Rays into wrapped samples end where closed formulas say, whatever the scale, and degenerate ones end at all."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from render.march import Entry, march, meets
from tests.render.reliefs import level, relief, step, waves


@pytest.fixture(scope="module")
def egg_tray():
    return relief(waves(), texels=16, deepest=0.1, plane=0.03, steps=100)


def entries(cosine, heading_rad=0.0, bending=(0.0, 0.0, 0.0), stretch=(1.0, 1.0), uv=(0.5, 0.5)) -> Entry:
    """Rays that come from behind `heading_rad`."""
    cosine = np.atleast_1d(np.asarray(cosine, dtype=np.float64))
    sine = np.sqrt(1 - cosine**2)
    view = np.stack([-sine * np.cos(heading_rad), -sine * np.sin(heading_rad), cosine], axis=1)
    spread = (
        np.broadcast_to(np.asarray(each, dtype=np.float64), (len(cosine), len(each))) for each in (stretch, bending)
    )
    return Entry(np.broadcast_to(np.asarray(uv, dtype=np.float64), (len(cosine), 2)), view, *spread)


@settings(max_examples=30, deadline=None)
@given(
    radius=st.floats(1e-3, 1e3),
    share=st.floats(0.0, 0.6),
    heading_rad=st.floats(-4.0, 4.0),
    steps=st.integers(1, 4),
)
def test_a_sphere_loses_exactly_its_depth(radius, share, heading_rad, steps):
    """A sphere of one depth is a smaller sphere: rays at a distance from its middle meet it or pass it by.

    So it is for rays that enter no flatter than what was measured; the others are below.
    """
    structure = level(share)
    away = np.linspace(0.01, 0.98, 61)  # of the radius: the lowest measured direction is 10 deg over the horizon
    cosine = np.sqrt(1 - away**2)
    bend = (1 / radius, 0.0, 1 / radius)
    meeting = march(structure, entries(cosine, heading_rad, bend, (radius, radius)), steps)
    left = 1 - structure.deepest
    clear = np.abs(away - left) > 1e-9
    np.testing.assert_array_equal(meeting.found[clear], away[clear] < left)
    expected = cosine - np.sqrt(np.maximum(left**2 - away**2, 0.0))
    found = meeting.found
    np.testing.assert_allclose(meeting.distance[found], radius * expected[found], rtol=1e-6, atol=1e-9 * radius)


def test_where_rays_are_flatter_than_measured_a_sphere_loses_half_of_its_depth_or_more():
    """Two looks, each of which goes no less than 0.3 of what is left; and never more than its depth."""
    structure = level(0.002)
    away = np.linspace(0.99, 0.9999, 200)
    meeting = march(structure, entries(np.sqrt(1 - away**2), bending=(1.0, 0.0, 1.0)))
    lost = 1 - away[meeting.found].max()
    assert 0.5 * structure.deepest < lost <= structure.deepest + 1e-4


def test_a_cylinder_bends_only_across_its_axis():
    """Across it a cylinder of one depth loses that depth; along it, it is as deep as a plane."""
    structure, away = level(0.1), np.array([0.3, 0.85, 0.95])
    cosine = np.sqrt(1 - away**2)
    bend = (1.0, 0.0, 0.0)
    np.testing.assert_array_equal(march(structure, entries(cosine, 0.0, bend)).found, [True, True, False])
    along = march(structure, entries(cosine, np.pi / 2, bend))
    assert along.found.all()
    np.testing.assert_allclose(along.distance, structure.deepest / cosine)


def test_a_ray_over_a_sphere_passes_the_texels_under_it():
    """Under the meeting lies the foot of the true point: its angle around the sphere, in tiles."""
    away = np.array([0.2, 0.5, 0.8])
    structure = level(0.1)
    meeting = march(structure, entries(np.sqrt(1 - away**2), bending=(1.0, 0.0, 1.0), stretch=(0.5, 0.5)), 3)
    left = 1 - 0.5 * structure.deepest
    turned = np.arcsin(away / left) - np.arcsin(away)
    height = (structure.plane - structure.deepest) / meeting.view[:, 2]
    at_the_surface = meeting.uv[:, 0] + height * meeting.view[:, 0]
    np.testing.assert_allclose(at_the_surface, 0.5 + turned / 0.5, atol=1e-9)
    np.testing.assert_allclose(
        meeting.turn @ [0.0, 0.0, 1.0], np.stack([-np.sin(turned), 0 * turned, np.cos(turned)], 1)
    )


@pytest.mark.parametrize("steps", [1, 3])
def test_a_wall_on_a_plane_is_met_where_the_ray_reaches_it(steps):
    """Toward a wall that rises to the left, rays end on it or below it; a measured direction shows no other's view."""
    structure = relief(step(), texels=32, deepest=0.2, steps=100)
    u = np.array([0.55, 0.6, 0.7, 0.9])
    view = np.tile(structure.views.directions[1], (4, 1))
    meeting = march(structure, Entry(np.column_stack([u, 0 * u]), view, np.ones((4, 2)), np.zeros((4, 3))), steps)
    expected = np.minimum((u - 0.5) / np.tan(np.radians(30.0)), 0.2)
    # A texel is 1/32 wide, and so is what it knows of the wall.
    np.testing.assert_allclose(meeting.distance * view[:, 2], expected, atol=np.sqrt(3) / 32)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), scale=st.floats(1e-4, 1e4))
def test_all_lengths_scale_together(egg_tray, seed, scale):
    rng = np.random.default_rng(seed)
    cosine, bend = rng.uniform(0.01, 1.0, 20), rng.normal(size=(20, 3))
    here = entries(cosine, rng.uniform(-4, 4), stretch=(1.0, 1.3))
    there = Entry(here.uv, here.view, scale * here.stretch, bend / scale)
    one, other = march(egg_tray, Entry(here.uv, here.view, here.stretch, bend)), march(egg_tray, there)
    np.testing.assert_array_equal(one.found, other.found)
    np.testing.assert_allclose(other.distance, scale * one.distance, rtol=1e-6)
    np.testing.assert_allclose(other.uv, one.uv, rtol=1e-6, atol=1e-6)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_where_a_ray_ends_is_a_number(egg_tray, seed):
    """Level rays, rays from under the horizon, and surfaces that bend within a tile, either way."""
    rng = np.random.default_rng(seed)
    view = rng.normal(size=(40, 3)) * [1.0, 1.0, rng.choice([0.0, 1e-9, 1.0])]
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    bend = rng.normal(size=(40, 3)) * 10.0 ** rng.integers(-9, 3)
    meeting = march(egg_tray, Entry(rng.uniform(size=(40, 2)), view, rng.uniform(1e-3, 3, (40, 2)), bend))
    assert np.isfinite(meeting.distance).all()
    assert (meeting.distance >= 0.0).all()
    assert np.isfinite(meeting.uv).all()
    np.testing.assert_allclose(np.linalg.norm(meeting.view, axis=1), 1.0)
    np.testing.assert_allclose(
        meeting.turn @ np.swapaxes(meeting.turn, 1, 2), np.tile(np.eye(3), (40, 1, 1)), atol=1e-9
    )


def test_without_depth_the_material_is_asked_where_the_ray_enters():
    """Also in steep, grazing and level views; directions under the lowest measured one are raised to it."""
    structure = level(0.0)
    entry = entries([1.0, 0.5, 1e-3, 0.0], bending=(1.0, 0.2, 0.5), uv=(0.1, 0.7))
    meeting = march(structure, entry)
    assert meeting.found.all()
    assert (meeting.distance == 0.0).all()
    np.testing.assert_allclose(meeting.uv, entry.uv)
    np.testing.assert_allclose(meeting.view, structure.views.raised(entry.view), atol=1e-3)


def test_flat_faces_with_sharp_edges_are_judged_as_the_paper_says():
    """A ray through the edge of a cube: what both faces take off must leave some of it."""
    structure, cosine = level(0.1), np.array([0.8, 0.8])
    front, back = march(structure, entries(cosine)), march(structure, entries(np.sqrt(1 - cosine**2)))
    taken = structure.deepest * (1 / 0.8 + 1 / 0.6)
    np.testing.assert_array_equal(meets(front, back, taken * np.array([0.999, 1.001])), [False, True])


def test_a_deep_hollow_at_the_back_does_not_hide_what_stands_in_front():
    """Through a sphere of two depths, the front half alone tells whether its own surface is met."""
    cosine = np.array([0.3])
    bend = (1.0, 0.0, 1.0)
    standing, hollow = (march(level(depth), entries(cosine, bending=bend)) for depth in (0.01, 0.3))
    assert meets(standing, hollow, 2 * cosine).all()
    assert meets(hollow, standing, 2 * cosine).all()
    assert not meets(hollow, hollow, 2 * cosine).any()
