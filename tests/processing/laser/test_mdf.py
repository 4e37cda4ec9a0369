"""The MDF of a bump from two views and three laser locations, against the marched truth at its texels."""

from dataclasses import replace

import numpy as np
import pytest

from processing import geometry
from processing.errors import ImageError
from processing.laser.mdf import Sweep, SweepResult, Weighting, mdf_from_sweeps, merge_view
from processing.laser.range_image import RangeImage, RangeStatus
from tests.reference.stripe_rig import HOLDER, SENSOR, Rig, bump, camera_at, shoot

TEXELS = 32
VIEWS = ((60.0, 0.0), (75.0, 90.0))  # elevation, turntable in degrees
LASERS = (40.0, -70.0, 160.0)


@pytest.fixture(scope="module")
def sweeps():
    return [
        Sweep(f"{elevation} {turn}", shoot(rig, seed)[0], SENSOR, rig.camera, rig.rig_from_sample, rig.mount)
        for elevation, turn in VIEWS
        for seed, rig in enumerate(Rig(camera_at(elevation), bump, turn, azimuth) for azimuth in LASERS)
    ]


@pytest.fixture(scope="module")
def result(sweeps):
    return mdf_from_sweeps(sweeps, HOLDER, TEXELS)


def truth(elevation, turn):
    """Displacement along the rays through the texels, by bisection on the bump, which hides nothing of itself here.

    NaN where the ray meets the opening's wall before the bump.
    """
    rig = Rig(camera_at(elevation), bump, turn)
    start = geometry.transform_points(rig.rig_from_sample, geometry.texel_grid(TEXELS, HOLDER.sample_m))
    rays = start - rig.camera.centre_m
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    low, high = np.zeros(start.shape[:2]), 0.0042 / -rays[..., 2]
    for _ in range(40):
        middle = 0.5 * (low + high)
        x, y, z = np.moveaxis(rig.local(start + middle[..., None] * rays), -1, 0)
        above = z > bump(x, y)
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    met = rig.local(start + high[..., None] * rays)
    return np.where(np.abs(met[..., :2]).max(axis=-1) < HOLDER.sample_m / 2, high, np.nan)


def test_mdf_is_the_surface(sweeps, result):
    """Half of the texels within a third of a step of the 8-bit code (4 mm / 255), nine of ten within two; few holes."""
    mdf, views = result
    assert [view.view for view in views] == [sweeps[0].view, sweeps[3].view]
    for sheet, variance, view in zip(mdf.displacement_m, mdf.variance_m2, VIEWS, strict=True):
        error = sheet - truth(*view)
        assert np.isfinite(sheet).mean() > 0.96  # a row ends at the wall of the opening
        found = np.abs(error[np.isfinite(error)])
        assert np.median(found) < 5.3e-6
        assert np.percentile(found, 90) < 32e-6
        inner = np.isfinite(error)
        ratio = error[inner] / np.sqrt(variance[inner])
        assert 0.7 < np.sqrt(np.mean(ratio**2)) < 1.3


def test_view_directions_turn_against_the_table(result):
    for direction, (elevation, turn) in zip(result[0].view_directions, VIEWS, strict=True):
        e, a = np.radians(elevation), np.radians(-turn)
        expected = (np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e))
        np.testing.assert_allclose(direction, expected, atol=1e-9)


def test_texels_under_the_reference_plane_see_along_other_rays(result, sweeps):
    """A ray through a texel of the deeper plane crosses the reference plane between texels, and meets the same bump."""
    deep, _ = mdf_from_sweeps(sweeps[:3], HOLDER, TEXELS, plane_m=1e-3)
    level = result[0]
    direction, inner = level.view_directions[0], (slice(4, -4), slice(4, -4))
    texels = direction[0] / direction[2] * 1e-3 / (HOLDER.texels_m / TEXELS)  # less than one, and no slope is steep
    shifted = level.displacement_m[0] + texels * np.gradient(level.displacement_m[0], axis=1)
    assert np.nanmedian(np.abs(deep.displacement_m[0] - shifted)[inner]) < 20e-6
    assert (deep.plane_m, level.plane_m) == (1e-3, 0.0)
    np.testing.assert_allclose(deep.depth_m()[0], deep.displacement_m[0] * direction[2], rtol=0.02)


def test_variances_weigh_better_than_volumes(sweeps, result):
    """On the same sweeps inverse variances predict the smaller error at almost every pixel, and have it."""
    papers, views = mdf_from_sweeps(sweeps[:3], HOLDER, TEXELS, Weighting.TETRAHEDRON)
    ours = result[1][0].merged
    both = (ours.used > 1) & (views[0].merged.used == ours.used)
    assert np.mean(ours.variance_m2[both] <= 1.0001 * views[0].merged.variance_m2[both]) > 0.99
    error, theirs = (np.abs(mdf.displacement_m[0] - truth(*VIEWS[0])) for mdf in (result[0], papers))
    assert np.nanmedian(error) < 1.02 * np.nanmedian(theirs)


def test_no_sweeps_are_refused():
    with pytest.raises(ImageError):
        mdf_from_sweeps([], HOLDER, 8)


def test_a_sample_eight_times_larger_keeps_the_same_locations(sweeps):
    """Rough by a tenth of a pixel: how much locations may differ grows with what a pixel sees; powers of two round not.

    At the eightfold size with the roughness of the single one most of them would be left out.
    """
    rng = np.random.default_rng(5)
    pixel_m = 1e-3  # 1 m away with a focal length of 1000 pixels
    camera = sweeps[0].camera
    values = 0.002 + 0.1 * pixel_m * rng.normal(size=(12, *camera.size))
    found = []
    for scale in (1.0, 8.0):
        pose = camera.rig_from_camera.copy()
        pose[:3, 3] *= scale
        sweep = replace(sweeps[0], camera=replace(camera, rig_from_camera=pose), frames=())
        variance = np.full(camera.size, (0.01 * pixel_m * scale) ** 2, np.float32)
        status = np.full(camera.size, RangeStatus.MEASURED, np.uint8)
        images = [RangeImage(np.float32(scale) * value.astype(np.float32), variance, status) for value in values]
        found.append(merge_view("", [SweepResult(sweep, None, None, i) for i in images], Weighting.VARIANCE).merged)
    np.testing.assert_array_equal(found[1].displacement_m, np.float32(8.0) * found[0].displacement_m)
    np.testing.assert_array_equal(found[1].used, found[0].used)
    assert np.mean(found[0].used) > 0.9 * 12
