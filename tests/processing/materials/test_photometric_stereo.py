"""Normals from shading: true where the surface is matt, unmoved by shadow and highlight, honest about the rest."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.materials.photometric_stereo import _triples, find_depth, find_normals
from processing.products import LightStack, NormalStatus
from tests.reference import photometric_stereo as plain
from tests.reference import shapes

PIXEL_M = 0.0005
DISTANT = np.inf


def stack_of(images, lights, distances_m=None, sigma=0.0, seed=0) -> LightStack:
    rng = np.random.default_rng(seed)
    value = images + sigma * rng.standard_normal(images.shape)
    distances_m = np.full(len(lights), DISTANT) if distances_m is None else distances_m
    variance = np.full(images.shape, sigma**2, np.float32)
    return LightStack(value.astype(np.float32), variance, lights, distances_m, PIXEL_M)


def errors_rad(found, truth, where=None):
    cosine = (found.normals * truth).sum(axis=-1)[found.measured if where is None else where & found.measured]
    return np.arccos(np.clip(cosine, -1, 1))


@pytest.mark.parametrize("count", [4, 6, 24, 150])
def test_a_matt_surface_in_the_light_is_exact(count):
    truth, lights = shapes.hills(16, seed=1, height=0.1), shapes.dome(count, lowest_deg=45)
    found = find_normals(stack_of(shapes.shaded(truth, lights), lights))
    assert found.measured.all()
    assert errors_rad(found, truth[1]).max() < 1e-3
    np.testing.assert_allclose(found.albedo, np.broadcast_to([0.6, 0.5, 0.4], found.albedo.shape), rtol=1e-4)


def test_near_lights_tell_how_far_the_surface_is():
    """Lamps at five times the object's size, a ball not where the stack's origin is: depth is found from the light."""
    (height, normal), lights = shapes.ball(24), shapes.dome(16, lowest_deg=50)
    height = height + 0.3
    half_m = 12 * PIXEL_M
    distances = np.full(16, 5.0)
    stack = stack_of(shapes.shaded((height, normal), lights, distances), lights, distances * half_m)
    middle = normal[..., 2] > 0.5
    known, flat = find_normals(stack, height * half_m), find_normals(stack, np.zeros_like(height))
    assert errors_rad(known, normal, middle).max() < 2e-3
    assert np.median(errors_rad(flat, normal, middle)) > 0.05
    assert np.median(errors_rad(find_normals(stack), normal, middle)) < 5e-3
    assert np.median(np.abs(find_depth(stack) / half_m - height)[middle]) < 0.02


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.integers(5, 20), st.sampled_from([0.0, 0.01, 0.1]))
def test_every_pixel_is_what_the_formulas_say(seed, count, shine):
    rng = np.random.default_rng(seed)
    lights = shapes.dome(count)
    images = shapes.shaded(shapes.hills(5, seed), lights, gloss=shine)[:, 2:3, 1:3]
    images *= np.where(rng.uniform(size=(count, 1, 1, 1)) < 0.15, 0.3, 1.0)
    stack = stack_of(images, lights, sigma=0.002, seed=seed)
    stack.reflectance_cos[rng.uniform(size=images.shape) < 0.03] = np.nan
    found = find_normals(stack)
    samples = [
        plain.grey_samples(stack.reflectance_cos[:, 0, x].astype(float), stack.variance[:, 0, x]) for x in (0, 1)
    ]
    known = [np.isfinite(grey) for grey, _ in samples]
    pixels = [(grey[k], variance[k], lights[k]) for (grey, variance), k in zip(samples, known, strict=True)]
    begun = [plain.start(*pixel, _triples()) for pixel in pixels]
    misfit = max(np.median([relative for _, relative in begun]), 0)
    for x, (pixel, (b, _)) in enumerate(zip(pixels, begun, strict=True)):
        if found.measured[0, x]:
            expected, _ = plain.refined(*pixel, b, misfit)
            np.testing.assert_allclose(found.normals[0, x], expected / np.linalg.norm(expected), atol=2e-5)


def test_shadows_and_highlights_are_left_out():
    """Gloss and cast shadows over hills: least squares errs by degrees, this by a third of that or less."""
    truth, lights = shapes.hills(40, seed=3), shapes.dome(24)
    images = shapes.shaded(truth, lights, gloss=0.3, exponent=80, cast=True)
    found = find_normals(stack_of(images, lights, sigma=0.001))
    ours = errors_rad(found, truth[1])
    by_all = plain.lambertian(images, lights)
    theirs = np.arccos((by_all * truth[1]).sum(axis=-1) / np.linalg.norm(by_all, axis=-1))
    assert found.measured.mean() > 0.98
    assert np.median(ours) < np.median(theirs) / 3
    assert np.mean(ours) < np.mean(theirs) / 2


@pytest.mark.parametrize("count", [6, 16])
def test_the_variance_tells_the_truth(count):
    """Of 1600 pixels of a matt surface with noise the errors are as large as said, within what chance does."""
    truth, lights = shapes.hills(40, seed=4, height=0.1), shapes.dome(count, lowest_deg=45)
    found = find_normals(stack_of(shapes.shaded(truth, lights), lights, sigma=0.003, seed=count))
    ratio = np.sqrt(np.mean(errors_rad(found, truth[1]) ** 2) / np.mean(found.variance[found.measured]))
    assert 0.7 < ratio < 1.3


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 10_000), st.floats(1e-6, 1e6))
def test_the_unit_of_light_and_the_order_of_lights_do_not_matter(seed, scale):
    rng = np.random.default_rng(seed)
    lights = shapes.dome(10)
    images = shapes.shaded(shapes.hills(8, seed), lights, gloss=0.05)
    before = find_normals(stack_of(images, lights, sigma=0.001))
    order = rng.permutation(10)
    stack = stack_of(images, lights, sigma=0.001)
    scaled = LightStack(
        stack.reflectance_cos * np.float32(scale), stack.variance * np.float32(scale) ** 2, lights,
        stack.light_distances_m, PIXEL_M,
    )  # fmt: skip
    np.testing.assert_allclose(find_normals(scaled).normals, before.normals, atol=1e-4)
    turned = LightStack(
        stack.reflectance_cos[order], stack.variance[order], lights[order], stack.light_distances_m, PIXEL_M
    )
    # Ten samples have 120 triples, of which 64 are tried: another order may start elsewhere, and rarely ends there.
    after = find_normals(turned)
    both = before.measured & after.measured
    assert np.median(np.abs(after.normals - before.normals)[both]) < 1e-3


def test_a_light_that_is_not_measured_is_no_light():
    lights = shapes.dome(9)
    images = shapes.shaded(shapes.hills(8, seed=5), lights)
    stack = stack_of(images, lights, sigma=0.001)
    less = LightStack(stack.reflectance_cos[1:], stack.variance[1:], lights[1:], stack.light_distances_m[1:], PIXEL_M)
    stack.reflectance_cos[0] = np.nan
    np.testing.assert_array_equal(find_normals(stack).normals, find_normals(less).normals)


def test_pixels_say_why_they_have_no_normal():
    lights = shapes.dome(8, lowest_deg=45)
    images = shapes.shaded(shapes.hills(6, seed=6, height=0.1), lights)
    images[:, 0, 0] = np.nan
    images[3:, 0, 1] = np.nan
    images[2:, 0, 2] = 0.0
    images[:, 0, 3] *= np.array([1, 9, 0.1, 5, 0.2, 3, 0.4, 7])[:, None]
    found = find_normals(stack_of(images, lights, sigma=0.0005))
    expected = [NormalStatus.NO_SAMPLES, NormalStatus.TOO_FEW, NormalStatus.TOO_FEW, NormalStatus.INCONSISTENT]
    assert found.status[0, :4].tolist() == expected
    assert np.isnan(found.normals[0, :4]).all()
    assert np.isnan(found.variance[0, :4]).all()
    assert found.measured.sum() == 32


@pytest.mark.parametrize("distance_m", [DISTANT, 1.0])
def test_lights_in_one_plane_determine_no_normal(distance_m):
    azimuth = np.radians(np.arange(-60, 61, 12))
    lights = np.stack([np.sin(azimuth), np.zeros(11), np.cos(azimuth)], axis=1)
    images = shapes.shaded(shapes.hills(6, seed=7), lights)
    found = find_normals(stack_of(images, lights, np.full(11, distance_m), sigma=1e-4))
    assert (found.status == NormalStatus.RANK_DEFICIENT).all()


@pytest.mark.parametrize("distance_m", [DISTANT, 0.05])
def test_black_and_missing_pictures_have_no_normals(distance_m):
    lights = shapes.dome(6)
    for images in (np.zeros((6, 3, 3, 3)), np.full((6, 3, 3, 3), np.nan)):
        found = find_normals(stack_of(images, lights, np.full(6, distance_m)))
        assert not found.measured.any()
        assert np.isfinite(found.depth_m).all()
