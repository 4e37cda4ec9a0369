"""The factored BTF: light from everywhere, and ways to store its maps."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.products import DirectionMesh, FactoredBtf
from processing.products.map_coding import encode
from tests.benchmarks.yardsticks.material_samples import rings

RIG = rings(((15, 12), (30, 12), (45, 12), (60, 12), (75, 12)))  # 12 x 5, without the top


def btf(rng, rank=3, channels=3, size=(4, 5)) -> FactoredBtf:
    """Any maps and weights."""
    mesh = DirectionMesh.from_directions(RIG)
    maps = rng.uniform(0, 1, (rank, len(RIG), *size, channels)).astype(np.float32)
    return FactoredBtf(maps, rng.normal(size=(rank, len(RIG))).astype(np.float32), mesh, mesh)


def test_shares_of_the_cosine_are_a_third_of_the_triangles_around_a_direction():
    """What reaches the border besides belongs to the border's directions."""
    mesh = DirectionMesh.from_directions(RIG)
    a, b, c = (mesh.directions[mesh.triangles[:, k], :2] for k in range(3))
    area = 0.5 * np.linalg.det(np.stack([b - a, c - a], axis=1))
    around = np.bincount(mesh.triangles.ravel(), np.repeat(area, 3) / 3, len(RIG)) / np.pi
    np.testing.assert_allclose(mesh.cosine_shares[:48], around[:48], rtol=0.01)
    assert (mesh.cosine_shares[48:] > around[48:]).all()
    assert mesh.cosine_shares.sum() == pytest.approx(1)


def test_ambient_light_is_the_mean_over_lights_spread_by_the_cosine(rng):
    material = btf(rng)
    spread = np.sqrt(rng.uniform(0, 1, 40_000)), rng.uniform(0, 2 * np.pi, 40_000)
    xy = np.column_stack([spread[0] * np.cos(spread[1]), spread[0] * np.sin(spread[1])])
    light = np.column_stack([xy, np.sqrt(1 - spread[0] ** 2)])
    uv, view = np.array([[0.3, 0.7]]), np.array([[0.36, -0.48, 0.8]])
    values = material.evaluate(np.repeat(uv, len(light), axis=0), light, np.repeat(view, len(light), axis=0))
    error = values.std(axis=0) / np.sqrt(len(light))
    assert (np.abs(material.ambient(uv, view)[0] - values.mean(axis=0)) < 4 * error + 1e-3 * np.abs(values).max()).all()


def test_a_matt_surface_sends_back_its_reflectance_of_ambient_light():
    mesh = DirectionMesh.from_directions(RIG)
    maps = np.full((1, len(RIG), 2, 2, 3), 0.2, np.float32)
    material = FactoredBtf(maps, np.ones((1, len(RIG)), np.float32), mesh, mesh)
    found = material.ambient(np.array([[0.1, 0.9]]), np.array([[0.0, 0.6, 0.8]]))
    assert found == pytest.approx(np.full((1, 3), 0.2), rel=1e-6)


def in_colours(rng, rank=3) -> FactoredBtf:
    """Grey maps, and weights that carry the colour."""
    made = btf(rng, rank, channels=1)
    return FactoredBtf(made.eigenmaps, rng.normal(size=(rank, len(RIG), 3)).astype(np.float32), made.lights, made.views)


@pytest.mark.parametrize("kind", [np.uint8, np.float16, None])
def test_under_a_measured_light_all_views_see_what_evaluation_says(rng, kind):
    texel, light = np.array([[(2 + 0.5) / 5, (1 + 0.5) / 4]]), 17
    for made in (btf(rng), in_colours(rng)):
        made = made if kind is None else made.coded(kind)
        count = len(RIG)
        asked = np.repeat(texel, count, axis=0), np.repeat(RIG[[light]], count, axis=0)
        expected = made.evaluate(*asked, RIG)
        np.testing.assert_allclose(made.under(light)[:, 1, 2], expected, rtol=1e-4, atol=1e-5)


def test_grey_maps_with_coloured_weights_are_the_same_as_coloured_maps_where_colours_do_not_change(rng):
    grey = in_colours(rng)
    tint = np.array([0.5, 1.0, 0.25], np.float32)
    one = FactoredBtf(grey.eigenmaps, grey.weights[:, :, :1] * tint, grey.lights, grey.views)
    other = FactoredBtf(grey.eigenmaps * tint, grey.weights[:, :, 0], grey.lights, grey.views)
    at = rng.uniform(-1, 2, (20, 2)), RIG[:20], RIG[40:]
    np.testing.assert_allclose(one.evaluate(*at), other.evaluate(*at), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(one.ambient(*at[::2]), other.ambient(*at[::2]), rtol=1e-5, atol=1e-6)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-30, 1e-6, 1.0, 1e6, 1e30]), st.booleans())
def test_codes_lie_within_half_a_step_of_their_values_at_any_scale(seed, scale, flat):
    rng = np.random.default_rng(seed)
    maps = (rng.normal(size=(2, 3, 4, 5, 3)) * (0 if flat else scale) + scale * rng.normal()).astype(np.float32)
    span = np.ptp(maps, axis=(2, 3, 4)).astype(np.float64)
    largest = np.abs(maps).max(axis=(2, 3, 4))
    for kind, bound in ((np.uint8, 0.5 / 255 * span + 2e-7 * largest), (np.float16, 2**-11 * largest)):
        codes, coding = encode(maps, kind)
        back = np.stack([coding.decode(codes[k], k, slice(None)) for k in range(2)])
        assert codes.dtype == kind
        assert (np.abs(back.astype(np.float64) - maps).max(axis=(2, 3, 4)) <= 1.001 * bound).all()


def test_black_maps_stay_black():
    codes, coding = encode(np.zeros((1, 2, 3, 3, 1), np.float32), np.uint8)
    assert (coding.decode(codes[0], 0, slice(None)) == 0).all()


@pytest.mark.parametrize("kind", [np.uint8, np.float16])
@pytest.mark.parametrize("make", [btf, in_colours])
def test_codes_are_saved_and_loaded_and_evaluated_as_their_values(tmp_path, rng, kind, make):
    made = make(rng).coded(kind)
    made.save(tmp_path)
    back = FactoredBtf.load(tmp_path)
    plain = FactoredBtf(np.stack([made.values(k) for k in range(3)]), made.weights, made.lights, made.views)
    at = rng.uniform(-1, 2, (20, 2)), RIG[:20], RIG[40:]
    assert back.eigenmaps.dtype == kind
    assert back.nbytes == made.nbytes < plain.nbytes
    np.testing.assert_array_equal(back.evaluate(*at), made.evaluate(*at))
    np.testing.assert_allclose(back.evaluate(*at), plain.evaluate(*at), rtol=1e-6)
    np.testing.assert_allclose(back.ambient(*at[::2]), plain.ambient(*at[::2]), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("index", [2, 3, 4])
def test_azimuth_has_no_seam_at_its_full_turn(rng, index):
    """On 12 x 5 directions, between the last azimuth (330 deg) and the first, as anywhere else."""
    material = in_colours(rng)
    ring = RIG[12 * index : 12 * (index + 1)]
    turns = np.radians([-1e-6, 1e-6, -15.0, 345.0])
    level = np.hypot(*ring[0, :2])
    around = np.column_stack([level * np.cos(turns), level * np.sin(turns), np.full(4, ring[0, 2])])
    uv, top = np.full((4, 2), 0.4), np.tile(RIG[30], (4, 1))
    for at in ((uv, around, top), (uv, top, around)):
        values = material.evaluate(*at)
        # A millionth of a degree changes a value by no more of its range of some ten.
        np.testing.assert_allclose(values[0], values[1], atol=1e-5)
        np.testing.assert_allclose(values[2], values[3], atol=1e-9)
    middle = material.lights.weights(around[2:3])[0][0]
    assert {0, 11} <= {int(n) % 12 for n in middle}
