"""A BTF and an MDF joined to one material."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.errors import ImageError
from processing.geometry import texel_grid
from processing.highlights import white_of
from processing.mesostructure import filled, mesostructure_from
from processing.products import Btf, DirectionMesh, Mdf
from processing.svd import factor_btf
from tests.benchmarks.yardsticks.material_samples import rings

DIRECTIONS = rings(((0, 1), (40, 6), (70, 6)))
VIEWS = DirectionMesh.from_directions(DIRECTIONS)
SIDE_M, TEXELS = 0.054, 8


def black() -> Btf:
    """A BTF of these views under three lights."""
    return Btf(np.zeros((3, len(DIRECTIONS), TEXELS, TEXELS, 3), np.float32), DIRECTIONS[:3], DIRECTIONS)


def measured(depth_m: np.ndarray, plane_m: float = 0.0, away_m: float = np.inf) -> Mdf:
    """The MDF whose depths (view, y, x) these are, from eyes at one distance."""
    even = Mdf(
        np.ones_like(depth_m), depth_m, DIRECTIONS, SIDE_M, plane_m=plane_m,
        distances_m=np.full(len(DIRECTIONS), away_m),
    )  # fmt: skip
    return replace(even, displacement_m=depth_m / even.depth_m())


def some_depths(seed: int, holes: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    depth_m = rng.uniform(0, 4e-3, (len(DIRECTIONS), TEXELS, TEXELS))
    depth_m[rng.uniform(size=depth_m.shape) < holes] = np.nan
    return depth_m


@given(st.integers(0, 100), st.sampled_from((np.inf, 1.0, 0.3)), st.sampled_from((0.0, 1e-3)))
@settings(max_examples=15, deadline=None)
def test_depths_come_back_to_half_a_step_from_any_distance(seed, away_m, plane_m):
    depth_m = some_depths(seed)
    joined = mesostructure_from(black(), measured(depth_m, plane_m, away_m))
    made = joined.mesostructure
    assert np.abs(made.depths * made.step * SIDE_M - depth_m).max() <= 0.5001 * made.step * SIDE_M
    assert made.depths.max() == 255
    assert (made.plane, joined.filled) == (plane_m / SIDE_M, 0.0)


def test_a_depth_is_the_distance_times_its_own_rays_cosine():
    """A level floor seen by an eye 0.5 m away: what is D of each texel is found by cutting its ray."""
    eye = 0.5 * DIRECTIONS[9]
    texels = texel_grid(TEXELS, SIDE_M, -1e-3)
    rays = texels - eye
    entry, floor = (eye + rays * ((z - eye[2]) / rays[..., 2:]) for z in (0.0, -3e-3))
    distance = np.linalg.norm(floor - entry, axis=-1)[None]
    mdf = Mdf(distance, distance, DIRECTIONS[9:10], SIDE_M, plane_m=1e-3, distances_m=np.array([0.5]))
    np.testing.assert_allclose(mdf.depth_m(), 3e-3, rtol=1e-12)
    # With parallel rays the depth would lean: at 70 deg by a tenth over the square.
    assert np.ptp(replace(mdf, distances_m=None).depth_m()) > 2e-4


def test_where_eyes_stood_is_kept(tmp_path):
    for number, mdf in enumerate(
        (measured(some_depths(1), 1e-3, 0.7), replace(measured(some_depths(1)), distances_m=None))
    ):
        mdf.save(tmp_path / str(number))
        np.testing.assert_array_equal(Mdf.load(tmp_path / str(number)).depth_m(), mdf.depth_m())


@given(st.integers(0, 100), st.floats(0.0, 0.9), st.floats(1e-3, 1e3))
@settings(max_examples=25, deadline=None)
def test_holes_lie_between_what_is_known_and_scale_with_it(seed, share, scale):
    depth = some_depths(seed, share)
    depth[3] = np.nan  # a view of which nothing was measured
    whole = filled(depth, VIEWS)
    known = np.isfinite(depth)
    np.testing.assert_array_equal(whole[known], depth[known])
    assert np.nanmin(depth) <= whole.min()
    assert whole.max() <= np.nanmax(depth)
    # The solver stops within a hundred thousandth of the right side's length.
    np.testing.assert_allclose(filled(depth * scale, VIEWS), whole * scale, atol=1e-3 * scale * np.nanmax(depth))


def test_a_hole_in_a_level_floor_is_level():
    depth = np.full((len(DIRECTIONS), TEXELS, TEXELS), 0.002)
    depth[2:5, 1:6, 2:] = np.nan
    np.testing.assert_allclose(filled(depth, VIEWS), 0.002, rtol=1e-9)


def test_filled_depths_are_told_and_what_stands_out_is_put_on_the_plane():
    depth_m = some_depths(3)
    depth_m[0, :4], depth_m[1, 0, 0] = np.nan, -1e-4
    joined = mesostructure_from(black(), measured(depth_m))
    assert joined.filled == 4 * TEXELS / depth_m.size
    assert joined.mesostructure.depths[1, 0, 0] == 0


def test_views_are_found_by_their_direction_in_any_order():
    mdf = measured(some_depths(4))
    order = np.random.default_rng(4).permutation(len(DIRECTIONS))
    # Turned by a third of a degree, as a camera that was calibrated again might stand.
    turned = mdf.view_directions @ np.array(
        [[np.cos(0.006), np.sin(0.006), 0], [-np.sin(0.006), np.cos(0.006), 0], [0, 0, 1]]
    )
    mixed = replace(mdf, displacement_m=mdf.displacement_m[order], view_directions=turned[order], distances_m=None)
    one, other = (mesostructure_from(black(), each).mesostructure for each in (mdf, mixed))
    np.testing.assert_array_equal(one.depths, other.depths)


def test_a_flat_sample_in_the_plane_has_no_depth():
    made = mesostructure_from(black(), measured(np.zeros((len(DIRECTIONS), TEXELS, TEXELS)))).mesostructure
    assert made.deepest == 0.0


@pytest.mark.parametrize(("views", "terms"), [(len(DIRECTIONS), 8), (3, 3)])
def test_the_eigenmaps_are_eight_coloured_ones_in_bytes_or_as_many_as_there_are_views(views, terms):
    """They err as the terms that were not kept, and half a step of a byte's code."""
    values = np.random.default_rng(5).uniform(0, 1, (4, views, TEXELS, TEXELS, 3)).astype(np.float32)
    btf, mdf = Btf(values, DIRECTIONS[[0, 1, 3, 5]], DIRECTIONS[:views]), measured(some_depths(5))
    joined, exact = mesostructure_from(btf, mdf), factor_btf(btf, terms, "colour", white_of(btf))
    made = joined.mesostructure.btf
    assert (made.eigenmaps.dtype, made.eigenmaps.shape) == (np.uint8, (terms, 4, TEXELS, TEXELS, 3))
    assert joined.error == exact.relative_rmse(terms)
    for k in range(terms):
        assert np.abs(made.values(k) - exact.btf.values(k)).max() <= 0.501 * made.coding.step[k].max()


@pytest.mark.parametrize(
    ("mdf", "words"),
    [
        (measured(some_depths(1)[:, :4, :4]), "8 x 8 texels and the MDF 4 x 4"),
        (measured(np.full((len(DIRECTIONS), TEXELS, TEXELS), np.nan)), "was measured"),
        (replace(measured(some_depths(1)), view_directions=DIRECTIONS * [1, 1, -1]), "share no view"),
    ],
)
def test_what_does_not_fit_is_one_clear_error(mdf, words):
    with pytest.raises(ImageError, match=words):
        mesostructure_from(black(), mdf)


def test_missing_views_are_named():
    mdf = measured(some_depths(1))
    few = replace(
        mdf, displacement_m=mdf.displacement_m[:9], view_directions=DIRECTIONS[:9], distances_m=mdf.distances_m[:9]
    )
    with pytest.raises(ImageError, match=r"4 of the BTF's 13 views .*elevation 20 deg.* and 1 more"):
        mesostructure_from(black(), few)
