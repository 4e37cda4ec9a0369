import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.errors import ImageError
from processing.materials.measurements import sphere_measurements
from processing.materials.phong import FitStatus
from processing.materials.residual import RANK_TOLERANCE
from processing.materials.srf import (
    fit_phong,
    fit_phong_per_direction,
    fit_phong_to_btf,
    fit_srf,
    fit_srf_to_btf,
    fit_srf_to_stack,
)
from processing.products import (
    BlinnPhong,
    Btf,
    LightStack,
    NormalMap,
    NormalStatus,
    ReflectanceMaps,
    ResidualBasis,
    half_vectors,
    normals_of,
    sphere_normals,
    tangent_frames,
)

LOBE = BlinnPhong(np.array([0.3, 0.2, 0.1]), np.array([0.2, 0.2, 0.3]), 40.0)
SIZE = 24
NOISE = 0.003


def maps_of(value, directions, noise=NOISE, *, light_distance=np.inf, view_distance=np.inf):
    shape = (len(directions), SIZE, SIZE, 3)
    distances = np.full(len(directions), light_distance)
    variance = np.broadcast_to(np.asarray(noise**2, np.float32), shape)
    return ReflectanceMaps(value.reshape(shape).astype(np.float32), variance, directions, distances, view_distance)


def stone(rng, directions, *, lobe=LOBE, noise=NOISE, spread=0.03, **distances):
    """Maps of a material that is exactly the lobe plus s . H, and s in the tangent frame (texel, channel, 3)."""
    empty = maps_of(np.ones((len(directions), SIZE * SIZE, 3)), directions, **distances)
    measured = sphere_measurements(empty)
    s = spread * rng.normal(size=(SIZE * SIZE, 3, 3))
    value = lobe.evaluate_cosines(measured.cos_light, measured.half[..., 2])
    value = np.where(measured.valid, value + np.einsum("dtk,tck->dtc", measured.half, s), 0.0)
    return maps_of(value + noise * rng.normal(size=value.shape), directions, max(noise, 1e-6), **distances), s


def in_texels(fit):
    """The fitted s (texel, channel, 3)."""
    return np.moveaxis(fit.srf.residual, 0, 2).reshape(-1, 3, 3)


def test_lights_on_a_circle_have_rank_two_and_no_noise_across_it(rng, arm_directions):
    """A plain solve would return noise of any size in s_y; the shortest solution has none there at all."""
    maps, s = stone(rng, arm_directions)
    fit = fit_srf(maps, LOBE)
    assert (fit.rank == 2).all()
    frames = tangent_frames(sphere_normals(SIZE)).reshape(-1, 3, 3)
    camera, truth = (np.einsum("tji,tcj->tci", frames, one) for one in (in_texels(fit), s))
    assert np.abs(camera[..., 1]).max() < 1e-6
    # H fans over 60 deg: singular values in the ratio of about 3.
    assert 2 < np.median(fit.condition) < 5
    assert np.abs(camera[..., [0, 2]] - truth[..., [0, 2]]).max() < 10 * NOISE


def test_near_lights_do_not_turn_their_one_percent_into_a_third_measurement(rng, arm_directions):
    maps, _ = stone(rng, arm_directions, light_distance=12.0, view_distance=22.0)
    fit = fit_srf(maps, LOBE)
    assert (fit.rank == 2).all()
    assert np.abs(fit.srf.residual).max() < 0.3


def test_residual_of_an_exact_material_is_recovered_to_the_noise_bound(rng, arm_directions):
    """Two determined unknowns per texel from up to twelve samples: mean squared error of the function 2 / N."""
    maps, s = stone(rng, arm_directions)
    fit = fit_srf(maps, LOBE)
    measured = sphere_measurements(maps)
    error = np.einsum("dtk,tck->dtc", measured.half, in_texels(fit) - s)[measured.valid]
    count = measured.valid.sum(axis=0)
    bound = NOISE * np.sqrt(2 * count.size / count.sum())
    # 3456 pairs of unknowns: the ratio is good to 1 %.
    assert np.sqrt(np.mean(error**2)) < 1.05 * bound
    expected = (1 - 2 * count.size / count.sum()) * (NOISE / fit.peak) ** 2
    assert fit.mse_srf == pytest.approx(expected, rel=0.05)


def test_residual_lowers_the_error_and_figures_are_consistent(rng, arm_directions):
    maps, _ = stone(rng, arm_directions)
    fit = fit_srf(maps, LOBE)
    assert fit.mse_over_lobe < 0.1
    assert fit.mse_over_variance < 0.1
    assert fit.psnr_srf_db == pytest.approx(-10 * np.log10(fit.mse_srf))
    assert fit.psnr_srf_db > fit.psnr_lobe_db
    assert (fit.status == FitStatus.CONVERGED).all()


def test_joint_lobe_beats_the_average_of_single_directions(rng, arm_directions):
    maps, _ = stone(rng, arm_directions)
    measured = sphere_measurements(maps)
    joint, (average, fits) = fit_phong(measured), fit_phong_per_direction(measured)
    assert len(fits) == 12

    def error(lobe):
        return np.nanmean(np.where(measured.valid, measured.delta(lobe), np.nan) ** 2)

    assert error(joint.phong) <= error(average) * 1.0001
    np.testing.assert_allclose(joint.phong.exponent, LOBE.exponent, rtol=0.1)


def test_one_light_has_rank_one(rng, arm_directions):
    maps, _ = stone(rng, arm_directions[:1])
    fit = fit_srf(maps, LOBE)
    lit = fit.rank > 0
    assert (fit.rank[lit] == 1).all()
    assert (fit.status == FitStatus.TOO_FEW_SAMPLES).all()
    assert np.isfinite(fit.srf.residual[lit]).all()
    assert np.isnan(fit.srf.residual[~lit]).all()
    # One equation, three unknowns: nothing is left over.
    assert fit.mse_srf < 1e-12


def test_all_shadow_is_the_lobe_alone(rng, arm_directions):
    """Lights behind the sphere: no texel has a sample."""
    maps = maps_of(np.zeros((12, SIZE * SIZE, 3)), arm_directions * [1, 1, -1] * [0.01, 1, 1])
    fit = fit_srf(maps, LOBE)
    assert np.isnan(fit.srf.residual).all()
    assert (fit.rank == 0).all()
    assert (fit.status == FitStatus.TOO_FEW_SAMPLES).all()
    uv, up = np.full((1, 2), 0.5), np.array([[0.0, 0.0, 1.0]])
    np.testing.assert_allclose(fit.srf.evaluate(uv, up, up), LOBE.evaluate(up, up))


def test_black_material_has_no_lobe_and_no_residual(arm_directions):
    maps = maps_of(np.zeros((12, SIZE * SIZE, 3)), arm_directions)
    lobe = fit_phong(sphere_measurements(maps)).phong
    fit = fit_srf(maps, lobe)
    assert (lobe.diffuse == 0).all()
    assert np.abs(fit.srf.residual).max() == 0
    assert (fit.mse_srf, fit.mse_over_lobe, fit.mse_over_variance) == (0.0, 1.0, 1.0)


def test_saturated_highlights_that_are_marked_change_nothing_else(rng, arm_directions):
    maps, _ = stone(rng, arm_directions, noise=0.0)
    value = maps.reflectance_cos.copy()
    value[value > 0.4] = np.nan
    assert 0 < np.isnan(value).mean() < 0.2
    holed = maps_of(value, arm_directions, 1e-6)
    whole, fit = fit_srf(maps, LOBE), fit_srf(holed, LOBE)
    both = (fit.rank == 2) & (whole.rank == 2)
    assert both.mean() > 0.9
    np.testing.assert_allclose(fit.srf.residual[both], whole.srf.residual[both], atol=1e-4)


def test_missing_texels_stay_missing(rng, arm_directions):
    maps, _ = stone(rng, arm_directions)
    value = maps.reflectance_cos.copy()
    value[:, 3, 5] = np.nan
    fit = fit_srf(maps_of(value, arm_directions), LOBE)
    assert np.isnan(fit.srf.residual[:, 3, 5]).all()
    assert np.isfinite(np.delete(fit.srf.residual.reshape(3, -1, 3), 3 * SIZE + 5, axis=1)).all()


@settings(max_examples=10, deadline=None)
@given(st.floats(-6, 6))
def test_any_unit_gives_the_same_srf(decades):
    rng, factor = np.random.default_rng(1), 10**decades
    azimuth = np.radians([-60, -40, -20, 20, 40, 60])
    directions = np.stack([np.sin(azimuth), np.zeros(6), -np.cos(azimuth)], axis=1)
    maps, _ = stone(rng, directions)
    scaled = maps_of(maps.reflectance_cos.astype(np.float64) * factor, directions, NOISE * factor)
    here, there = fit_srf(maps, LOBE), fit_srf(scaled, BlinnPhong(LOBE.diffuse * factor, LOBE.specular * factor, 40.0))
    np.testing.assert_allclose(there.srf.residual / factor, here.srf.residual, rtol=1e-3, atol=1e-5)
    np.testing.assert_allclose(there.mse_over_lobe, here.mse_over_lobe, rtol=1e-3)


def test_noisier_samples_count_less(rng, arm_directions):
    """One direction is ten times noisier and says so: the error stays near that of the eleven others."""
    maps, s = stone(rng, arm_directions, noise=0.0)
    noise = np.full((12, 1, 1, 1), NOISE)
    noise[3] *= 10
    value = maps.reflectance_cos + noise * rng.normal(size=maps.reflectance_cos.shape)
    told = maps_of(value, arm_directions, noise)
    untold = maps_of(value, arm_directions, np.sqrt(np.mean(noise**2)))

    def error(given):
        measured = sphere_measurements(given)
        off = in_texels(fit_srf(given, LOBE)) - s
        return np.mean((np.einsum("dtk,tck->dtc", measured.half, off)[measured.valid]) ** 2)

    assert error(told) < 0.5 * error(untold)


def test_four_channels_are_refused(arm_directions):
    value = np.zeros((12, SIZE, SIZE, 4), np.float32)
    maps = ReflectanceMaps(value, value + 1, arm_directions, np.full(12, np.inf), np.inf)
    with pytest.raises(ImageError, match="channels"):
        sphere_measurements(maps)


def btf_of(rng, hemisphere, spread=0.03, texels=5):
    """A BTF that is exactly the lobe plus s . H over its cosine, and s (texel, texel, channel, 3)."""
    light, view = np.repeat(hemisphere, 40, axis=0), np.tile(hemisphere, (40, 1))
    s = spread * rng.normal(size=(texels, texels, 3, 3))
    value = LOBE.evaluate(light, view)[:, None, None] + np.einsum("dk,yxck->dyxc", half_vectors(light, view), s)
    reflectance = (value / light[:, 2, None, None, None]).reshape(40, 40, texels, texels, 3)
    return Btf(reflectance.astype(np.float32), hemisphere, hemisphere), s


def test_a_btf_determines_all_three_components_without_a_turn(rng, hemisphere):
    btf, s = btf_of(rng, hemisphere)
    fit = fit_srf_to_btf(btf, LOBE)
    assert (fit.rank == 3).all()
    assert fit.srf.wrap
    np.testing.assert_allclose(np.moveaxis(fit.srf.residual, 0, 2), s, atol=1e-5)
    assert fit.mse_over_lobe < 1e-6


def test_the_lobe_of_a_btf_is_that_of_its_mean(rng, hemisphere):
    btf, _ = btf_of(rng, hemisphere, spread=0.0)
    lobe = fit_phong_to_btf(btf).phong
    np.testing.assert_allclose(lobe.exponent, LOBE.exponent, rtol=1e-3)
    np.testing.assert_allclose(lobe.diffuse, LOBE.diffuse, rtol=1e-3)


def test_missing_samples_of_a_btf_take_no_part(rng, hemisphere):
    btf, s = btf_of(rng, hemisphere)
    btf.reflectance[rng.random(btf.reflectance.shape[:4]) < 0.3] = np.nan
    fit = fit_srf_to_btf(btf, LOBE)
    np.testing.assert_allclose(np.moveaxis(fit.srf.residual, 0, 2), s, atol=1e-5)


def test_rank_tolerance_keeps_what_the_arm_measures_and_drops_what_it_does_not(rng, arm_directions):
    """With all twelve lights; from 12 and 22 radii the half vectors leave their plane a little."""
    maps, _ = stone(rng, arm_directions, light_distance=12.0, view_distance=22.0)
    measured = sphere_measurements(maps)
    lit = (measured.cos_light > 0).all(axis=0)
    singular = np.linalg.svd(np.moveaxis(measured.half[:, lit], 0, 1), compute_uv=False)
    assert (singular[:, 2] < RANK_TOLERANCE / 2 * singular[:, 0]).all()
    assert (singular[:, 1] > RANK_TOLERANCE * 2 * singular[:, 0]).all()


def test_evaluated_in_the_tangent_frame_the_srf_shows_the_sphere_again(rng, arm_directions):
    """Each texel's light and view turned into its own frame, looked up at its own place."""
    maps, _ = stone(rng, arm_directions, noise=1e-6)
    srf = fit_srf(maps, LOBE).srf
    frames = tangent_frames(sphere_normals(SIZE)).reshape(-1, 3, 3)
    row, column = np.divmod(np.arange(SIZE * SIZE), SIZE)
    uv = np.stack([(column + 0.5) / SIZE, (row + 0.5) / SIZE], axis=1)
    view = frames @ np.array([0.0, 0.0, -1.0])
    for light, measured in zip(arm_directions, maps.reflectance_cos, strict=True):
        shown = srf.evaluate(uv, frames @ light, view)
        np.testing.assert_allclose(shown, measured.reshape(-1, 3), atol=2e-5)


def test_lobe_and_residual_of_a_btf_are_found_together(rng, hemisphere):
    """The mean of the residuals is no part of the lobe; k_d and s . H are told apart by their curvature."""
    btf, s = btf_of(rng, hemisphere)
    fit = fit_srf_to_btf(btf)
    np.testing.assert_allclose(fit.srf.phong.exponent, LOBE.exponent, rtol=1e-3)
    np.testing.assert_allclose(fit.srf.phong.diffuse, LOBE.diffuse, atol=1e-3)
    np.testing.assert_allclose(np.moveaxis(fit.srf.residual, 0, 2), s, atol=2e-3)


@pytest.mark.parametrize("basis", list(ResidualBasis))
def test_more_functions_leave_less_over(rng, hemisphere, basis):
    """Of a BTF of s . H and a little noise, every basis that has H in it leaves no more than H alone."""
    btf, _ = btf_of(rng, hemisphere)
    btf.reflectance[:] += (0.01 * rng.normal(size=btf.shape)).astype(np.float32)
    fit = fit_srf_to_btf(btf, LOBE, basis)
    assert fit.srf.residual.shape[-1] == basis.size
    assert fit.mse_srf < fit.mse_lobe
    if basis is ResidualBasis.HALF_LIGHT:
        assert fit.mse_srf <= fit_srf_to_btf(btf, LOBE).mse_srf


def bowl(rng, lights, *, distance_m=np.inf):
    """A stack of a shallow bowl of the lobe plus s . H, 30 x 24 pixels of 1 mm, its normals, and s (texel, 3, 3)."""
    y, x = np.mgrid[-12:12, -15:15] / 30.0
    normals = normals_of(x, y) * [1, -1, -1]
    frames = tangent_frames(normals.reshape(-1, 3) * [1, -1, -1]) * [1, -1, -1]
    shape, distances_m = (len(lights), 24, 30, 3), np.full(len(lights), distance_m)
    value, variance = np.zeros(shape, np.float32), np.full(shape, 1e-10, np.float32)
    toward = LightStack(value, variance, lights, distances_m, 1e-3).lights().reshape(len(lights), -1, 3)
    light = np.einsum("tij,dtj->dti", frames, toward)
    view = np.broadcast_to(frames[:, :, 2], light.shape)
    s = 0.03 * rng.normal(size=(720, 3, 3))
    value = LOBE.evaluate(light.reshape(-1, 3), view.reshape(-1, 3)).reshape(light.shape)
    value += np.einsum("dtk,tck->dtc", half_vectors(light, view), s)
    if np.isfinite(distance_m):
        columns, rows = np.meshgrid(np.arange(30) - 14.5, 11.5 - np.arange(24))
        points = np.stack([columns, rows, 0 * rows], axis=-1).reshape(-1, 3) * 1e-3
        way = lights[:, None] * distance_m - points
        value *= (distance_m**2 / (way**2).sum(axis=-1))[..., None]
    stack = LightStack(value.reshape(shape).astype(np.float32), variance, lights, distances_m, 1e-3)
    status = np.full((24, 30), NormalStatus.MEASURED, np.uint8)
    flat = np.zeros((24, 30), np.float32)
    return stack, NormalMap(normals.astype(np.float32), np.zeros((24, 30, 3), np.float32), flat, status, 1e-3), s


@pytest.mark.parametrize("distance_m", [np.inf, 0.25])
def test_an_object_of_any_shape_is_recovered(rng, hemisphere, distance_m):
    """Near lights too: each pixel has its own direction and falloff."""
    stack, normals, s = bowl(rng, hemisphere[:30], distance_m=distance_m)
    fit = fit_srf_to_stack(stack, normals)
    assert fit.srf.phong.exponent == pytest.approx(LOBE.exponent, rel=0.01)
    np.testing.assert_allclose(in_texels(fit), s, atol=2e-3)
    assert not fit.srf.wrap


def test_pixels_without_a_normal_take_no_part(rng, hemisphere):
    stack, normals, _ = bowl(rng, hemisphere[:20])
    whole = fit_srf_to_stack(stack, normals, LOBE)
    normals.status[:, :9] = NormalStatus.NO_SAMPLES
    normals.normals[:, :9] = np.nan
    fit = fit_srf_to_stack(stack, normals, LOBE)
    assert np.isnan(fit.srf.residual[:, :, :9]).all()
    assert (fit.status[:, :, :9] == FitStatus.TOO_FEW_SAMPLES).all()
    np.testing.assert_allclose(fit.srf.residual[:, :, 9:], whole.srf.residual[:, :, 9:], atol=1e-4)


def test_normals_of_another_picture_are_refused(rng, hemisphere):
    stack, normals, _ = bowl(rng, hemisphere[:20])
    other = LightStack(
        stack.reflectance_cos[:, 2:], stack.variance[:, 2:], stack.light_directions, stack.light_distances_m, 1e-3
    )
    with pytest.raises(ImageError, match="do not belong"):
        fit_srf_to_stack(other, normals)
