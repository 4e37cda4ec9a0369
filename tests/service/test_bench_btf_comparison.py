"""The comparison of representations of BTFs: its parts on what is known exactly, and all of them on a tiny sample."""

import numpy as np
import pytest

from tests.benchmarks.sbrdfs import comparison
from tests.benchmarks.yardsticks import btf_methods as methods
from tests.benchmarks.yardsticks.btf_errors import btf_errors
from tests.benchmarks.yardsticks.btf_methods import Given
from tests.benchmarks.yardsticks.btf_samples import (
    matt_plane,
    mirror_plane,
    quick_directions,
    ray_traced,
    ring_of,
)
from tests.benchmarks.yardsticks.local_pca import local_pca
from tests.benchmarks.yardsticks.picture_difference import mean_flip, mean_ssim

DIRECTIONS = quick_directions()


@pytest.fixture(scope="module")
def brick():
    return ray_traced("brick", 12, 3, DIRECTIONS, DIRECTIONS)


@pytest.fixture(scope="module")
def compared(brick):
    return comparison.compare(brick, quick=True)


def test_noise_is_small_and_the_same_question_is_answered_once(brick):
    """A bracket of 60 000 electrons a second leaves under a tenth of the values' deviation."""
    noise = brick.btf.reflectance - brick.true.reflectance
    assert 0 < noise.std() < 0.1 * brick.true.reflectance.std()
    assert ray_traced("brick", 12, 3, DIRECTIONS, DIRECTIONS.copy()) is brick


def test_planes_are_what_they_are_called():
    matt, mirror = (plane(3, DIRECTIONS, DIRECTIONS) for plane in (matt_plane, mirror_plane))
    np.testing.assert_allclose(matt.btf.reflectance, 0.5 / np.pi, rtol=1e-5)
    for plane in (matt, mirror):
        assert not plane.truth.shadowed.any()
        assert not plane.truth.hidden.any()
        assert not plane.truth.shift.any()
    opposite = np.argmax(DIRECTIONS @ (DIRECTIONS[3] * [-1, -1, 1]))
    assert mirror.btf.reflectance[3, opposite].min() > 100 * np.median(mirror.btf.reflectance)


def test_more_terms_come_nearer_and_as_many_as_views_are_all(brick):
    """Up to half floats, which hold 11 bits."""
    given = Given(brick.btf)
    of_texels, of_views = (
        [btf_errors(one.seen_from, brick.btf).relative for one in method(given, (1, 4, last))]
        for method, last in ((methods.svd, given.most_terms), (methods.svd_by_views, 19))
    )
    assert of_texels == sorted(of_texels, reverse=True)
    assert of_views == sorted(of_views, reverse=True)
    assert of_views[-1] < 1e-6


def test_clusters_find_points_on_two_lines():
    rng = np.random.default_rng(1)
    lines = [centre + rng.normal(size=(30, 1)) * rng.normal(size=(1, 6)) for centre in (0.0, 9.0)]
    points = np.concatenate(lines)
    found = local_pca(points, 2, 1)
    again = found.mean[found.label] + np.einsum("nk,nkp->np", found.weights(points), found.basis[found.label])
    np.testing.assert_allclose(again, points, atol=1e-9)
    assert len(np.unique(found.label[:30])) == len(np.unique(found.label[30:])) == 1


def test_more_clusters_than_points_are_no_error():
    points = np.eye(3)
    assert np.isfinite(local_pca(points, 5, 2).mean).all()


def test_ptm_per_view_is_exact_where_light_enters_as_a_polynomial():
    """A matt plane's value is the cosine of three polar angles: 1, 0.87 and 0.5, near a polynomial of their sines."""
    given = Given(matt_plane(2, DIRECTIONS, DIRECTIONS).btf)
    for one in (methods.ptm(given), methods.ptm_per_view(given)):
        errors = btf_errors(one.seen_from, given.btf)
        assert errors.relative < 1e-3
    assert methods.ptm_per_view(given).size_bytes == 19 * methods.ptm(given).size_bytes


def test_errors_of_the_truth_are_none_and_of_black_all(brick):
    cosine = Given(brick.true).cosine
    nothing = btf_errors(cosine.seen_from, brick.true)
    assert (nothing.mse, nothing.flip) == (0, 0)
    assert nothing.ssim == pytest.approx(1)
    black = btf_errors(lambda view: np.zeros_like(cosine.seen_from(view)), brick.true)
    assert black.relative == pytest.approx(1)
    assert black.views.mean() == pytest.approx(1) == black.texels.mean()
    assert list(black.rings) == np.unique(ring_of(DIRECTIONS)).tolist()
    assert black.spread()["view_worst"] >= black.spread()["view_p90"] >= black.spread()["view_median"]


def test_pictures_that_differ_more_have_less_similarity():
    rng = np.random.default_rng(2)
    true = rng.uniform(0.2, 1, (2, 16, 16, 3))
    noise = rng.normal(size=true.shape)
    similar = [mean_ssim(true, true + amount * noise) for amount in (0.0, 0.02, 0.1, 0.5)]
    different = [mean_flip(true, true + amount * noise) for amount in (0.0, 0.02, 0.1, 0.5)]
    assert similar == sorted(similar, reverse=True)
    assert different == sorted(different)


def test_every_method_has_a_row_and_lobes_with_shadows_and_places_come_nearer(compared):
    rows, given = compared
    assert {row["method"] for row in rows} == {
        "one lobe", "SVD", "SVD by views", "local PCA", "PTM", "PTM per view", "SRF", "SBRDF", "STVS", "SBRDF+",
    }  # fmt: skip
    for row in rows:
        assert np.isfinite([row["mse"], row["relative_mse"], row["texel_worst"], row["ssim"], row["flip"]]).all()
    errors = [row["relative_mse"] for row in rows if row["method"] in ("SBRDF", "STVS", "SBRDF+")]
    assert errors == sorted(errors, reverse=True)
    assert 1 - 1e-6 <= min(ratios := comparison.over_eckart_young(given, (1, 4))) <= max(ratios) <= 1.001


def test_lines_are_of_the_sizes_nearest_to_sbrdf_plus(compared):
    rows, _ = compared
    alike = comparison.as_large(rows)
    size = alike["SBRDF+"][0]["bytes"]
    of_svd = [row["bytes"] for row in rows if row["method"] == "SVD"]
    assert alike["SVD"][0]["bytes"] == min(of_svd, key=lambda other: abs(np.log(other / size)))
    assert {row["value"] for row in comparison.over_rings(rows)} == {0, 30, 60}
    assert all(row["seconds"] > 0 and row["error"] > 0 for row in comparison.over_time(rows))
