import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter1d

from processing.materials.limb_profile import DEPTHS_PX, limb_depth_px, mean_profile


def profile(depth_px, at_limb, radius_px=150.0, blur_px=0.9):
    """Of a sphere whose brightness goes from `at_limb` to 1 as (1 - cos)^5 does, whose limb lies at this depth."""
    fine = np.arange(-12, 14, 0.01)
    share = np.clip((fine - depth_px) / radius_px, 0, 1)
    cosine = np.sqrt(2 * share - share**2)
    bright = np.where(fine > depth_px, 1 + (at_limb - 1) * (1 - cosine) ** 5, 0.0)
    return np.interp(DEPTHS_PX, fine, gaussian_filter1d(bright, blur_px / 0.01))


@settings(max_examples=30, deadline=None)
@given(st.floats(-0.8, 0.8), st.floats(0.0, 1.6), st.floats(0.6, 1.3), st.floats(-6, 6))
def test_the_limb_is_found_whatever_the_material_does_at_grazing(depth_px, at_limb, blur_px, decades):
    """Half of the brightness inside is 0.5 px off where it fades out; the three terms leave a tenth."""
    found, _ = limb_depth_px(profile(depth_px, at_limb, blur_px=blur_px) * 10**decades)
    assert found == pytest.approx(depth_px, abs=0.1)


def test_sigma_is_the_scatter_under_noise(rng):
    clean = profile(0.1, 0.4)
    found = np.array([limb_depth_px(clean + 0.01 * rng.normal(size=clean.shape)) for _ in range(60)])
    # the deviation of 60 values is good to 9 %; the fit is not quite linear
    assert found[:, 0].std() == pytest.approx(np.median(found[:, 1]), rel=0.4)


@pytest.mark.parametrize(
    "values", [np.zeros(len(DEPTHS_PX)), np.ones(len(DEPTHS_PX)), np.linspace(0, 1, len(DEPTHS_PX))]
)
def test_a_profile_without_a_limb_tells_nothing(values):
    assert np.isnan(limb_depth_px(values)[0])


def test_dim_and_broken_rays_do_not_count():
    """A light that hardly reaches a ray, a ray with a hole, a ray in the dark."""
    good = profile(0.0, 1.0)
    rays = np.stack([np.stack([good, good, good, 0 * good]), np.stack([0.01 * good[::-1], 3 * good, good, 0 * good])])
    rays[1, 2, 5] = np.nan
    np.testing.assert_allclose(mean_profile(rays), mean_profile(good[None, None]))
    assert mean_profile(np.zeros((2, 3, len(DEPTHS_PX)))) is None
    assert mean_profile(np.full((2, 3, len(DEPTHS_PX)), np.nan)) is None
