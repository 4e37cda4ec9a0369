"""Texels from pixels: scale, holes, borders."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.laser.texel_range import texel_displacement

PITCH_M = 0.8e-3


def grid(texels, pixels_per_texel=2.0, start=6.3):
    """Image points (n, n, 2) of a square grid seen from straight above."""
    at = start + pixels_per_texel * np.arange(texels)
    return np.stack(np.meshgrid(at, at), axis=-1)


def wavy(size, sigma_m, rng):
    """A wave (size, size) in metres, its noise and the surface at any image point."""

    def surface(uv):
        return 1e-3 + 2e-4 * np.sin(0.3 * uv[..., 0]) + 1e-4 * np.cos(0.5 * uv[..., 1])

    pixels = np.stack(np.meshgrid(np.arange(size), np.arange(size)), axis=-1).astype(float)
    return surface(pixels) + sigma_m * rng.standard_normal((size, size)), surface


def test_waves_are_followed_below_the_pixels_noise():
    rng = np.random.default_rng(1)
    image, surface = wavy(96, 20e-6, rng)
    uv = grid(40)
    found, variance = texel_displacement(image, np.full(image.shape, 4e-10), uv, PITCH_M)
    error = found - surface(uv)
    assert np.sqrt(np.mean(error**2)) < 15e-6
    assert 0.8 < np.sqrt(np.mean(error**2 / variance)) < 1.2


@settings(max_examples=10, deadline=None)
@given(st.floats(1e-3, 1e3), st.integers(0, 99), st.booleans())
def test_a_larger_world_is_the_same_measurement(scale, seed, single):
    rng = np.random.default_rng(seed)
    image, _ = wavy(40, 20e-6, rng)
    image[10:14, 20:26] = np.nan
    image[25:, 30:] += 2e-3
    kind = np.float32 if single else np.float64
    plain = texel_displacement(image, np.full(image.shape, 4e-10), grid(14), PITCH_M)
    large = texel_displacement(
        (scale * image).astype(kind), np.full(image.shape, scale**2 * 4e-10, kind), grid(14), scale * PITCH_M
    )
    np.testing.assert_allclose(large[0] / scale, plain[0], rtol=0, atol=3e-6 if single else 1e-7)
    assert (np.isnan(large[1]) == np.isnan(plain[1])).all()


def test_holes_stay_holes_and_nothing_is_extrapolated():
    """Texels between measured pixels have a value, also of one pixel in four; beyond the last ones there is none."""
    rng = np.random.default_rng(2)
    image, surface = wavy(60, 5e-6, rng)
    image[:, 30:] = np.nan
    image[20:26, 10:16] = np.nan
    image[1::2], image[:, 1::2] = np.nan, np.nan
    uv = grid(40, 1.3, 2.1)
    found, variance = texel_displacement(image, np.full(image.shape, 25e-12), uv, PITCH_M)
    right, down = uv[..., 0], uv[..., 1]
    hole = (right > 10.6) & (right < 15.4) & (down > 20.6) & (down < 25.4)
    assert np.isnan(found[(right > 28.6) | hole]).all()
    assert (np.isnan(found) == np.isnan(variance)).all()
    well_inside = (right < 28) & ~((right > 7.9) & (right < 16.1) & (down > 17.9) & (down < 26.1)) & (down < 58)
    assert np.isfinite(found[well_inside]).all()
    assert np.nanmax(np.abs(found - surface(uv))) < 60e-6


def test_what_is_not_seen_is_missing():
    """Image points outside the image or nowhere, and an image without a measured pixel, or of one pixel."""
    rng = np.random.default_rng(3)
    image, _ = wavy(20, 5e-6, rng)
    uv = grid(12, 4.0, -10.0)
    uv[5, 5] = np.nan
    found, _ = texel_displacement(image, np.full(image.shape, 25e-12), uv, PITCH_M)
    outside = ~((uv > -0.5) & (uv < 19.5)).all(axis=-1)
    assert np.isnan(found[outside]).all()
    assert np.isfinite(found[~outside]).all()
    for nothing in (np.full((20, 20), np.nan), np.full((1, 1), np.nan)):
        assert np.isnan(texel_displacement(nothing, nothing, uv, PITCH_M)[0]).all()


def test_what_lies_between_yarns_is_not_bridged():
    """A slit two pixels wide in which nothing was measured, though four pixels wide surfaces lie on both sides."""
    rng = np.random.default_rng(4)
    image, _ = wavy(60, 5e-6, rng)
    slit = np.arange(60) % 6 < 2
    image[:, slit] = np.nan
    uv = grid(70, 0.8, 2.0)
    found, _ = texel_displacement(image, np.full(image.shape, 25e-12), uv, PITCH_M)
    place = (uv[..., 0] + 0.5) % 6  # 0 to 2 in the slit
    assert np.isnan(found[(place > 0.2) & (place < 1.8)]).all()
    assert np.isfinite(found[(place > 2.7) & (place < 5.3)]).all()


def test_single_missing_pixels_are_no_hole():
    rng = np.random.default_rng(5)
    image, surface = wavy(60, 5e-6, rng)
    image[5::6, 3::6] = np.nan
    uv = grid(60, 0.8, 4.0)
    found, _ = texel_displacement(image, np.full(image.shape, 25e-12), uv, PITCH_M)
    assert np.isfinite(found).all()
    assert np.abs(found - surface(uv)).max() < 60e-6
