"""The parts of a skin against what is known: plain twins, flat and rolled surfaces, frames and lookups."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.materials import skin_cut
from processing.materials.skin_atlas import covered_texels, unwrap
from processing.materials.skin_canvas import Source, cut_in, empty_canvas, sample
from processing.materials.skin_cut import least_cut, share_within
from processing.materials.skin_example import Fitter, example_of
from processing.materials.skin_field import tangent_field
from processing.materials.skin_patch import Sheet, empty_sheet, further_out, lay_flat, layout_of
from processing.materials.skin_surface import Surface, refine, weld
from processing.materials.skin_turn import STEPS, turning_table
from processing.products import ResidualBasis, bilinear_taps
from tests.reference.skin import ball, cheapest_closed_path, cylinder, misfits, nearest_triangle
from tests.render.synthetic import stone


def surface_of(positions, normals, triangles):
    return Surface(positions, normals, triangles, np.zeros((len(triangles), 3, 2)))


def laid(positions, normals, triangles, seed, radius):
    """Texels of a patch: where they are in space and where laid flat; the atlas is that of the mesh."""
    atlas = unwrap(positions, triangles, 40.0)
    surface = Surface(positions, normals, triangles, atlas.uv_texels[atlas.triangles])
    texels = covered_texels(surface.corner_uv, atlas.shape)
    layout = layout_of(surface, tangent_field(surface, 2 * radius), texels)
    sheet = empty_sheet(layout)
    filled = lay_flat(layout, sheet, seed, radius, 0)
    texel = sheet.texel[:filled]
    second, third = texels.barycentric[texel].T
    weights = np.stack([1 - second - third, second, third], axis=1)
    inside = (weights >= 0).all(axis=1)
    space = np.einsum("nk,nkc->nc", weights, positions[triangles[texels.triangle[texel]]])
    return space[inside], sheet.xy[:filled][inside], sheet.turn_rad[:filled][inside]


@pytest.mark.parametrize("basis", ResidualBasis)
@settings(max_examples=20, deadline=None)
@given(st.integers(0, STEPS - 1), st.integers(0, 2**32 - 1))
def test_turned_coefficients_are_the_same_function(basis, step, seed):
    rng = np.random.default_rng(seed)
    angle = 2 * np.pi * step / STEPS
    c, s = np.cos(angle), np.sin(angle)
    frame = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    light, view = rng.normal(size=(2, 20, 3)) * [1, 1, 0] + [0, 0, 0.5]
    light, view = (d / np.linalg.norm(d, axis=1, keepdims=True) for d in (light, view))
    coefficients = rng.normal(size=basis.size)
    in_turned = basis.evaluate(light @ frame.T, view @ frame.T) @ coefficients
    np.testing.assert_allclose(
        basis.evaluate(light, view) @ turning_table(basis)[step] @ coefficients, in_turned, atol=1e-9
    )


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(3, 5), st.integers(1, 5))
def test_closed_path_is_the_cheapest(seed, rows, columns):
    cost = np.random.default_rng(seed).random((rows, columns))
    path = skin_cut._closed_path(cost)
    assert all(abs(path[k] - path[k - 1]) <= skin_cut._STEEPEST for k in range(rows))
    assert cost[np.arange(rows), path].sum() == pytest.approx(cheapest_closed_path(cost, skin_cut._STEEPEST))


def test_cut_follows_the_line_of_least_difference_and_goes_round_the_overlap():
    """A groove in the error, off the middle; nothing lies on the right side, where the line goes outside."""
    cells, reach = 41, 19.0
    y, x = np.mgrid[:cells, :cells] - 20.0
    error = 1.0 - np.exp(-((np.hypot(x + 2, y) - 13.0) ** 2) / 4)
    radii = least_cut(error, np.ones((cells, cells)), reach)
    angle = 2 * np.pi * np.arange(len(radii)) / len(radii)
    away = np.hypot(radii * np.cos(angle) + 2, radii * np.sin(angle))
    assert np.abs(away - 13.0).max() < 1.5
    half = least_cut(error, (x < 0).astype(float), reach)
    assert half[np.abs(angle - np.pi) < 1.0].max() < 17
    assert half[np.cos(angle) > 0.6].min() > 17.5


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_place_is_one_of_the_best(seed, wrap):
    """The error at the chosen place is within a tenth of the least, by the definition."""
    rng = np.random.default_rng(seed)
    example = example_of(stone(32, 32, wrap=wrap), 1.0)
    piece, mask = rng.normal(scale=0.5, size=(6, 6, 4)), (rng.random((6, 6)) > 0.4).astype(float)
    errors = misfits(example.cells.astype(float), piece, mask, wrap)
    chosen = Fitter(example, 6).choose(piece, mask, rng)
    assert errors[chosen] <= 1.1 * errors.min() + 1e-6


def test_piece_of_the_example_is_found_where_it_was_taken(rng):
    example = example_of(stone(32, 32), 1.0)
    piece = np.roll(example.cells, (-11, -14), axis=(0, 1))[:6, :6].astype(float)
    assert Fitter(example, 6).choose(piece, np.ones((6, 6)), rng) == (11, 14)


def test_field_is_level_and_smooth_where_the_surface_stands():
    positions, normals, triangles = ball(24, 48)
    field = tangent_field(surface_of(positions, normals, triangles), 0.3)
    np.testing.assert_allclose(np.sum(field * normals, axis=1), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(field, axis=1), 1.0, atol=1e-9)
    standing = np.abs(positions[:, 2]) < 0.8
    level = np.cross([0, 0, 1], normals[standing])
    level /= np.linalg.norm(level, axis=1, keepdims=True)
    assert np.sum(field[standing] * level, axis=1).min() > np.cos(np.radians(12))


def test_field_over_a_plate_that_lies_is_the_samples_frame():
    """t = +X and b = +Y, as a sample has it."""
    x, y = np.meshgrid(np.arange(4.0), np.arange(4.0))
    positions = np.stack([x.ravel(), y.ravel(), np.zeros(16)], axis=1)
    first = (np.arange(3)[:, None] * 4 + np.arange(3)).ravel()
    triangles = np.concatenate([np.stack([first, first + 1, first + 5], 1), np.stack([first, first + 5, first + 4], 1)])
    normals = np.broadcast_to([0.0, 0.0, 1.0], (16, 3))
    field = tangent_field(surface_of(positions, normals, triangles.astype(np.int32)), 1.0)
    np.testing.assert_allclose(field, np.broadcast_to([1.0, 0.0, 0.0], (16, 3)), atol=1e-6)


def test_rolled_surface_is_laid_flat_without_stretch():
    """On a cylinder x is the arc from the seed and y the height, but for the facets of 7.5 deg."""
    positions, normals, triangles = cylinder()
    seed = 5 * 48 + 7
    space, xy, turn_rad = laid(positions, normals, triangles, seed, 0.8)
    arc = np.arctan2(space[:, 1], space[:, 0]) - 2 * np.pi * 7 / 48
    flat = np.stack([arc, space[:, 2] - positions[seed, 2]], axis=1)
    assert len(xy) > 1000
    assert np.abs(xy - flat).max() < 0.03
    assert np.abs(turn_rad).max() < 0.02


def test_ball_is_laid_flat_with_little_stretch():
    """To half a radian from the seed, also at the pole, where the field has a zero: nothing is torn."""
    positions, normals, triangles = ball(32, 64)
    for seed in (16 * 64, len(positions) - 2):
        space, xy, _ = laid(positions, normals, triangles, seed, 0.5)
        far = np.arccos(np.clip(space @ positions[seed], -1, 1))
        assert far.max() > 0.45
        assert np.abs(np.hypot(*xy.T) - far).max() < 0.08


@settings(max_examples=10, deadline=None)
@given(st.floats(0.15, 3.0))
def test_refined_surface_is_the_same_and_closed(longest):
    positions, normals, triangles = ball(5, 8)
    surface = refine(surface_of(positions, normals, triangles), longest)
    corners = surface.positions[surface.triangles]
    assert np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max() <= longest * (1 + 1e-12)
    volume = [
        np.sum(np.einsum("nj,nj->n", c[:, 0], np.cross(c[:, 1], c[:, 2]))) for c in (corners, positions[triangles])
    ]
    assert volume[0] == pytest.approx(volume[1])
    edges = {(int(t[k]), int(t[k - 1])) for t in surface.triangles for k in range(3)}
    assert len(edges) == 3 * len(surface.triangles)
    assert all((b, a) in edges for a, b in edges)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_welded_mesh_does_not_depend_on_how_it_was_split(seed):
    rng = np.random.default_rng(seed)
    positions, normals, triangles = ball(6, 9)
    own = triangles.ravel()
    order = rng.permutation(len(own))
    split = np.argsort(order).reshape(triangles.shape).astype(np.int32)
    place, places, mean = weld(positions[own][order].astype(np.float32), normals[own][order], split)
    assert len(places) == len(positions)
    corners = places[place[split]]
    np.testing.assert_allclose(corners, positions[triangles], atol=1e-6)
    np.testing.assert_allclose(mean, places, atol=1e-6)


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_texels_know_the_triangle_under_them_or_beside_them(seed):
    """As by testing every triangle: inside and in a gutter a texel and a half wide, and nothing beyond."""
    rng = np.random.default_rng(seed)
    corners = np.stack([rng.uniform(2, 5, 2), rng.uniform(8, 11, 2) * [1, 0.5], rng.uniform(8, 11, 2) * [0.5, 1]])
    other = np.stack([corners[1], corners[1] + corners[2] - corners[0], corners[2]])
    corner_uv = np.stack([corners, other])
    texels = covered_texels(corner_uv, (20, 20))
    found = dict(zip(texels.index.tolist(), zip(texels.triangle, texels.barycentric, strict=True), strict=True))
    for index in range(20 * 20):
        place = np.array([index % 20 + 0.5, index // 20 + 0.5])
        triangle, far = nearest_triangle(corner_uv, place)
        assert (index in found) == (far < 1.5)
        if far == 0:
            number, (second, third) = found[index]
            assert number == triangle
            weights = np.array([1 - second - third, second, third])
            np.testing.assert_allclose(weights @ corner_uv[number], place, atol=1e-9)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_sampling_is_bilinear_lookup(seed):
    rng = np.random.default_rng(seed)
    image = rng.normal(size=(5, 7, 2)).astype(np.float32)
    places = rng.uniform(-10, 20, (12, 2))
    rows, columns, weights = bilinear_taps(places / [7, 5], 5, 7, wrap=True)
    value = np.empty(2)
    for place, expected in zip(places, np.einsum("nt,ntc->nc", weights, image[rows, columns]), strict=True):
        sample(image, *place, value)
        np.testing.assert_allclose(value, expected, atol=1e-6)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from(list(ResidualBasis)))
def test_patches_blend_as_the_formula_says(seed, basis):
    """Two patches one over the other: old and new by their shares, the new one turned into the surface's frame."""
    rng = np.random.default_rng(seed)
    count, k = 40, basis.size
    coefficients = rng.normal(size=(24, 24, 3 * k)).astype(np.float32)
    source = Source(coefficients, rng.normal(size=(3 * k, 4)), turning_table(basis))
    canvas = empty_canvas(source, count)
    expected, cover = np.zeros((count, 3 * k)), np.zeros(count)
    for number in range(2):
        xy, steps = rng.uniform(-6, 6, (count, 2)), rng.integers(STEPS, size=count)
        mark = np.zeros(count, np.int32)
        piece = Sheet(
            np.arange(count, dtype=np.int32), xy, 2 * np.pi * steps / STEPS, xy, xy[:, 0], xy, mark, mark, mark
        )
        radii = rng.uniform(3, 6, 96)
        cut_in(canvas, piece, source, (11.0, 12.0), radii, number)
        rows, columns, taps = bilinear_taps((np.array([11.0, 12.0]) + xy * [1, -1]) / 24, 24, 24, wrap=True)
        taken = np.einsum("nt,ntc->nc", taps, coefficients[rows, columns]).reshape(count, 3, k)
        turned = np.einsum("nij,ncj->nci", source.turning[steps], taken).reshape(count, -1)
        share = np.array([share_within(x, y, radii, 3.0) for x, y in xy])
        kept = (1 - share) * cover
        cover = np.where(share > 0, share + kept, cover)
        new = np.divide(share, cover, out=np.zeros(count), where=cover > 0)[:, None]
        expected = (1 - new) * expected + new * turned
    np.testing.assert_allclose(canvas.value, expected, atol=1e-4)
    np.testing.assert_allclose(canvas.cover, cover, atol=1e-9)
    np.testing.assert_allclose(canvas.seen, expected @ source.seen, atol=1e-3)


def test_seeds_lie_ahead_of_the_edge_within_reach():
    positions, normals, triangles = cylinder()
    surface = surface_of(positions, normals, triangles)
    texels = covered_texels(np.zeros((0, 3, 2)), (2, 2))
    layout = layout_of(surface, np.cross([0.0, 0.0, 1.0], normals), texels)
    ahead = further_out(layout, positions[:, 2], 5, 0.9)
    assert 0.5 < positions[ahead, 2] <= 0.9
    assert further_out(layout, positions[:, 2], 5, 0.01) == 5
