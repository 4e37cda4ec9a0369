"""Clusters of hidden points: shares of the views, missing values, k-means against its plain form."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.products import Btf, StoredBtf
from processing.sbrdf.clusters import ClusterStatus, centre_count, cluster_hidden
from processing.sbrdf.k_means import KMeansStatus, k_means, nearest_centre
from processing.sbrdf.k_means_kernel import rounds, seed
from processing.sbrdf.samples import Samples
from tests.reference import k_means as plain
from tests.reference.sbrdf_plus import directions

LIGHTS, VIEWS, HEIGHT, WIDTH = 6, 5, 7, 9
FEW = settings(max_examples=40, deadline=None)


def samples(seed=0, views=VIEWS, kinds=4):
    """Points of a few kinds and little noise."""
    rng = np.random.default_rng(seed)
    kind = rng.integers(0, kinds, (views, HEIGHT, WIDTH))
    colours = rng.uniform(0.05, 0.3, (kinds, LIGHTS, 3))
    btf = np.moveaxis(colours[kind], 3, 0) + rng.normal(0, 1e-3, (LIGHTS, views, HEIGHT, WIDTH, 3))
    return Samples.of(Btf(btf.astype(np.float32), directions(LIGHTS, rng), directions(views, rng)))


def hidden(seed=0, share=0.4, views=VIEWS):
    return np.random.default_rng(seed).uniform(size=(views, HEIGHT, WIDTH)) < share


def values(samples, hidden):
    return np.concatenate([np.moveaxis(samples.seen_from(v)[:, hidden[v]], 1, 0) for v in range(len(hidden))])


def used(clusters, hidden):
    """Centres that each view has."""
    return np.array([len(np.unique(index[mask])) for index, mask in zip(clusters.index, hidden, strict=True)])


def test_the_papers_sizes_give_its_centres():
    assert centre_count(81, 81, 64, 64) == 1984


def test_points_of_few_kinds_find_them():
    """Twice as many centres as kinds: what is left is the noise of the samples."""
    seen, mask = samples(), hidden()
    clusters = cluster_hidden(seen, mask, 8 * VIEWS)
    assert (clusters.status == ClusterStatus.CONVERGED).all()
    left = values(seen, mask) - clusters.centres[clusters.index[mask]]
    noise = 1e-3 * seen.light_directions[:, 2].max() / seen.scale
    assert left.std() < 1.1 * noise
    np.testing.assert_allclose(clusters.error @ mask.sum(axis=(1, 2)) / mask.sum(), np.mean(left**2), rtol=1e-4)


@FEW
@given(st.integers(0, 99), st.integers(0, 400), st.floats(0, 1))
def test_views_share_in_proportion(seed, count, share):
    """Within one of the exact part, except that no view with points goes without; never more centres than points."""
    rng = np.random.default_rng(seed)
    mask = rng.uniform(size=(VIEWS, HEIGHT, WIDTH)) < rng.uniform(0, share, (VIEWS, 1, 1))
    points = mask.sum(axis=(1, 2))
    clusters = cluster_hidden(samples(seed), mask, count)
    assert len(clusters.centres) == min(count, points.sum())
    assert (clusters.index[mask] < max(len(clusters.centres), 1)).all()
    assert (clusters.index[~mask] == 0).all()
    assert (used(clusters, mask) <= points).all()
    if count >= (points > 0).sum():
        own = [clusters.index[v][mask[v]] for v in range(VIEWS) if points[v]]
        assert all(a.max() < b.min() for a, b in pairwise(own))
        exact = points * count / max(points.sum(), 1)
        most = np.minimum(np.maximum(np.ceil(exact), 1), points)
        assert (used(clusters, mask) <= most).all()


def test_nothing_hidden_makes_no_centre():
    clusters = cluster_hidden(samples(), np.zeros((VIEWS, HEIGHT, WIDTH), bool))
    assert clusters.centres.shape == (0, LIGHTS, 3)
    assert (clusters.status == ClusterStatus.NO_POINTS).all()
    assert np.isnan(clusters.error).all()


def test_enough_centres_hold_every_point():
    seen, mask = samples(), np.ones((VIEWS, HEIGHT, WIDTH), bool)
    clusters = cluster_hidden(seen, mask, mask.size)
    np.testing.assert_allclose(clusters.centres[clusters.index[mask]], values(seen, mask), atol=1e-6)


def test_no_centre_at_all_leaves_points_without():
    clusters = cluster_hidden(samples(), hidden(), 0)
    assert clusters.centres.shape == (0, LIGHTS, 3)
    assert (clusters.status == ClusterStatus.NO_CENTRES).all()


def test_views_left_out_take_the_nearest_of_all():
    seen, mask = samples(), hidden()
    clusters = cluster_hidden(seen, mask, 2)
    assert (clusters.status == ClusterStatus.NO_CENTRES).sum() == VIEWS - 2
    apart = ((values(seen, mask)[:, None] - clusters.centres) ** 2).sum(axis=(2, 3))
    left_out = np.flatnonzero(clusters.status == ClusterStatus.NO_CENTRES)
    of_view = np.nonzero(mask)[0]
    chosen = np.isin(of_view, left_out)
    np.testing.assert_array_equal(clusters.index[mask][chosen], apart.argmin(axis=1)[chosen])


def test_order_of_views_does_not_matter():
    seen, mask, order = samples(), hidden(), np.array([3, 0, 4, 2, 1])
    turned = Samples(
        Btf(seen.btf.reflectance[:, order], seen.light_directions, seen.view_directions[order]), seen.scale
    )
    one, other = cluster_hidden(seen, mask, 11), cluster_hidden(turned, mask[order], 11)
    np.testing.assert_array_equal(one.centres[one.index[mask]].shape, other.centres[other.index[mask[order]]].shape)
    for place, view in enumerate(order):
        mine = one.centres[one.index[view][mask[view]]]
        np.testing.assert_array_equal(mine, other.centres[other.index[place][mask[view]]])


def test_a_stored_btf_gives_the_same(tmp_path):
    """Views are read by several threads at a time."""
    seen, mask = samples(), hidden()
    seen.btf.save(tmp_path)
    one = cluster_hidden(Samples(StoredBtf.open(tmp_path), seen.scale), mask, 20)
    other = cluster_hidden(Samples(Btf.load(tmp_path), seen.scale), mask, 20)
    np.testing.assert_array_equal(one.index, other.index)
    np.testing.assert_array_equal(one.centres, other.centres)


def test_one_view_takes_all():
    clusters = cluster_hidden(samples(views=1), hidden(views=1), 3)
    assert len(clusters.centres) == 3


def test_reflectance_of_centres_has_no_cosine():
    seen, mask = samples(), hidden()
    clusters = cluster_hidden(seen, mask, 20)
    told = clusters.reflectance(seen) * seen.light_directions[:, 2:] / seen.scale
    np.testing.assert_allclose(told, clusters.centres, rtol=1e-5)


def test_missing_values_are_left_out():
    """With a tenth missing, and one light of a view, points still find their kind; nothing is NaN."""
    seen, mask = samples(), hidden()
    holes = np.random.default_rng(1).uniform(size=seen.btf.reflectance.shape) < 0.1
    seen.btf.reflectance[holes] = np.nan
    seen.btf.reflectance[2, 1] = np.nan
    clusters = cluster_hidden(seen, mask, 8 * VIEWS)
    assert np.isfinite(clusters.centres).all()
    left = values(seen, mask) - clusters.centres[clusters.index[mask]]
    assert np.nanstd(left) < 1.2e-3 * seen.light_directions[:, 2].max() / seen.scale


def test_points_without_any_value_do_no_harm():
    seen = samples()
    seen.btf.reflectance[:] = np.nan
    clusters = cluster_hidden(seen, hidden(), 9)
    assert (clusters.centres == 0).all()


@pytest.mark.parametrize("factor", [1e-30, 1e-6, 1e6, 1e30])
def test_scale_of_the_values_does_not_matter(factor):
    vectors = np.random.default_rng(2).uniform(size=(200, 12)).astype(np.float32)
    one, other = k_means(vectors, 7), k_means(vectors * np.float32(factor), 7)
    np.testing.assert_array_equal(one.index, other.index)
    np.testing.assert_allclose(other.centres / np.float32(factor), one.centres, rtol=1e-5)


def test_equal_points_leave_no_error():
    found = k_means(np.full((30, 5), 0.3, np.float32), 4)
    assert found.status == KMeansStatus.CONVERGED
    assert found.error < 1e-14


@FEW
@given(st.integers(0, 99), st.integers(1, 60), st.integers(1, 30), st.booleans())
def test_each_vector_has_the_nearest_centre(seed, count, width, holes):
    """Against all differences in double precision; ties within rounding count as equal."""
    rng = np.random.default_rng(seed)
    vectors = rng.uniform(size=(60, width)).astype(np.float32)
    if holes:
        vectors[rng.uniform(size=vectors.shape) < 0.2] = np.nan
    found = k_means(vectors, count)
    for index in (found.index, nearest_centre(vectors, found.centres)):
        apart = np.nansum((vectors[:, None].astype(np.float64) - found.centres) ** 2, axis=2)
        chosen = np.take_along_axis(apart, index[:, None], axis=1)[:, 0]
        np.testing.assert_allclose(chosen, apart.min(axis=1), atol=1e-5 * max(width, 1))
    if count == 60 and not holes:
        assert found.error < 1e-12


@pytest.mark.parametrize("holes", [False, True])
@pytest.mark.parametrize("number", range(6))
def test_loops_equal_their_plain_form(number, holes):
    """Random values have no ties, so single precision and skipped comparisons change nothing but rounding."""
    rng = np.random.default_rng(number)
    count, width, k = rng.integers(2, 150), rng.integers(1, 40), rng.integers(1, 9)
    present = (rng.uniform(size=(count if holes else 1, width)) < (0.8 if holes else 2.0)).astype(np.float32)
    values = rng.normal(size=(count, width)).astype(np.float32) * present
    every = np.broadcast_to(present, values.shape)
    draws = rng.uniform(size=(k, 4))
    chosen = seed(values, present, draws)
    np.testing.assert_array_equal(chosen, plain.seed(values, every, draws))
    centres, index = values[chosen], np.zeros(count, np.intp)
    converged, left = rounds(values, present, centres, index, (30, 1e-4))
    told = plain.rounds(values, every, values[chosen], (30, 1e-4))
    np.testing.assert_allclose(centres, told[0], atol=1e-5)
    np.testing.assert_array_equal(index, told[1])
    assert converged == told[2]
    np.testing.assert_allclose(left, told[3], rtol=1e-4)


def test_seeds_leave_less_error_than_random_ones():
    """Clumps of very different sizes: a start from random vectors misses the small ones."""
    rng = np.random.default_rng(5)
    clumps = np.repeat(np.arange(12), [400, *[5] * 11])
    vectors = (rng.normal(size=(12, 20)) * 3)[clumps] + rng.normal(scale=0.1, size=(len(clumps), 20))
    assert k_means(vectors.astype(np.float32), 12).error < 1.1 * 0.1**2
