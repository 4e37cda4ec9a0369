"""Lamps over a white plate: intensity, falloff and distance from how the light spreads."""

from dataclasses import replace

import numpy as np
import pytest

from processing.errors import CalibrationError, ImageError
from processing.lamps.calibration import measure_lamps
from processing.lamps.model import LampPlaces, LampStatus, nominal_places
from processing.lamps.white import CELLS, PlateCells, fit_plate
from processing.radiometry.hdr import PixelStatus, Radiance
from tests.reference.lamp_rig import PLATE_M, LampRig

RIG = LampRig.of(1)
ABOVE = [f"lamp{i}" for i in range(8)]
SOME = ("lamp1", "lamp5")


def some_views(seed):
    """Of two lamps: enough where no statistics are asked for."""
    return [view for view in RIG.plate_views(np.random.default_rng(seed)) if view.lamp in SOME]


def fitted(views, rig=RIG):
    return fit_plate(views, nominal_places(rig.nominal), 0.9)


def test_truth_lies_within_the_deviations():
    """Places, after what a mirror with cameras of unsure distance leaves open, intensities, and the exponent."""
    places, lights, exponents = [], [], []
    for seed in range(3):
        rig, rng = LampRig.of(seed), np.random.default_rng(seed)
        fit = fit_plate(rig.plate_views(rng), _after_a_mirror(rig, rng), 0.9)
        exponents.append((fit.falloff - 2) / fit.falloff_deviation)
        for name in ABOVE:
            row = fit.places.names.index(name)
            off = fit.places.positions_m[row] - rig.position(name)
            places.append(off @ np.linalg.solve(fit.places.covariance(name), off) / 3)
            light = fit.log_intensity[row] - rig.log_intensity(name)
            lights.append(light.mean() ** 2 / fit.log_variance[row].mean())
    # 72 numbers: their root mean square scatters by 8 %; intensities share the plate's and the cameras' errors
    assert 0.8 < np.sqrt(np.mean(places)) < 1.2
    assert np.sqrt(np.mean(lights)) < 1.5
    assert np.abs(exponents).max() < 3


def _after_a_mirror(rig, rng):
    """Directions to 0.03 deg, distances to 3 %."""
    names = tuple(sorted(rig.nominal))
    positions, covariance = [], np.zeros((3 * len(names), 3 * len(names)))
    for number, name in enumerate(names):
        true = rig.position(name)
        outward = np.outer(true, true) / (true @ true)
        own = true @ true * (0.03**2 * outward + np.radians(0.03) ** 2 * (np.eye(3) - outward))
        covariance[3 * number : 3 * number + 3, 3 * number : 3 * number + 3] = own
        positions.append(rng.multivariate_normal(true, own))
    return LampPlaces(names, np.array(positions), covariance)


def test_the_exponent_of_another_falloff_is_told_and_used():
    """The mirror tells the distances, without which exponent and distance cannot be told apart."""
    known = nominal_places(RIG.nominal)
    true = np.stack([RIG.position(name) for name in known.names])
    sure = replace(known, positions_m=true, covariance_m2=1e-6 * np.eye(true.size))
    for exponent in (1.5, 2.0):
        views = RIG.plate_views(np.random.default_rng(1), falloff=exponent)
        fit = fit_plate([view for view in views if view.lamp in ("lamp1", "lamp3", "lamp5")], sure, 0.9)
        assert fit.falloff == pytest.approx(exponent, abs=4 * fit.falloff_deviation)
        assert fit.falloff_deviation < 0.05
        assert fit.held == pytest.approx(exponent, abs=0.1)
    assert fit.held == 2.0


def test_brighter_lamps_change_intensities_alone():
    views = some_views(2)
    brighter = [replace(view, log_value=view.log_value + np.log(1e6)) for view in views]
    one, other = fitted(views), fitted(brighter)
    np.testing.assert_allclose(other.places.positions_m, one.places.positions_m, atol=1e-5)
    rows = [one.places.names.index(name) for name in SOME]
    np.testing.assert_allclose(other.log_intensity[rows] - one.log_intensity[rows], np.log(1e6), atol=1e-3)


def test_the_order_of_views_does_not_matter():
    views = some_views(3)
    np.testing.assert_allclose(fitted(views).places.positions_m, fitted(views[::-1]).places.positions_m, atol=1e-5)


def test_shadows_and_dust_take_no_part():
    views = some_views(4)
    spoilt = []
    for number, view in enumerate(views):
        log_value = view.log_value.copy()
        log_value[40 * (number % 5) : 40 * (number % 5) + 25] -= 1.0
        spoilt.append(replace(view, log_value=log_value))
    one, other = fitted(views), fitted(spoilt)
    deviations = np.sqrt(np.diag(one.places.covariance_m2)).reshape(-1, 3)
    assert (np.abs(other.places.positions_m - one.places.positions_m) < 2 * deviations).all()


def test_cells_that_were_not_measured_take_no_part():
    views = []
    for view in some_views(5):
        information = view.information.copy()
        information[:60] = 0.0
        views.append(replace(view, information=information, log_value=np.where(information > 0, view.log_value, 0.0)))
    assert np.isfinite(fitted(views).places.positions_m).all()


def test_lamps_without_the_mirror_are_rated_by_what_the_plate_tells():
    views = [view for view in RIG.plate_views(np.random.default_rng(6)) if view.lamp != "lamp2"]
    models, white = measure_lamps(RIG.nominal, [], None, views, 0.9)
    assert white is not None
    assert models["lamp2"].status == models["led"].status == LampStatus.NOT_MEASURED
    assert np.isnan(models["lamp2"].intensity_e_s).all()
    assert models["lamp5"].status != LampStatus.NOT_MEASURED
    np.testing.assert_allclose(models["lamp5"].intensity_e_s, np.exp(RIG.log_intensity("lamp5")), rtol=0.2)


def test_stray_light_of_a_lamp_level_with_the_plate_harms_no_other():
    views = some_views(8)
    models, _ = measure_lamps(RIG.nominal, [], None, [*views, replace(views[0], lamp="led")], 0.9)
    plain, _ = measure_lamps(RIG.nominal, [], None, views, 0.9)
    assert models["led"].status == LampStatus.NOT_MEASURED
    np.testing.assert_allclose(models["lamp5"].position_m, plain["lamp5"].position_m, rtol=1e-9)
    with pytest.raises(CalibrationError, match="dark in every picture"):
        fitted([replace(view, lamp="led") for view in views])


def test_a_dark_plate_is_one_clear_error():
    views = [replace(view, information=0 * view.information) for view in some_views(7)]
    with pytest.raises(CalibrationError, match="dark in every picture"):
        fitted(views)


def test_a_saturated_pixel_spoils_its_cell_and_no_other():
    camera = RIG.cameras["cam7"]
    cells = PlateCells.of(camera, np.array([[0, 1], [1, 2]], np.uint8), PLATE_M)
    value = np.full(camera.size, 1000.0, np.float32)
    whole = cells.view(Radiance(value, value / 100, np.zeros(camera.size, np.uint8)), "lamp0", "cam7", 0.0)
    uv_px = np.rint(camera.project(np.zeros(3))).astype(int)
    value[uv_px[1], uv_px[0]] = np.nan
    spoilt = cells.view(Radiance(value, value / 100, np.zeros(camera.size, np.uint8)), "lamp0", "cam7", 0.0)
    lost = (whole.information > 0) & (spoilt.information == 0)
    assert lost.sum() == 1
    row, column = np.divmod(np.flatnonzero(lost.any(axis=1))[0], CELLS)
    assert {row, column} <= {CELLS // 2 - 1, CELLS // 2}
    np.testing.assert_allclose(whole.log_value[whole.information > 0], np.log(1000), rtol=1e-6)


def test_a_picture_of_another_camera_is_refused():
    cells = PlateCells.of(RIG.cameras["cam7"], np.array([[0, 1], [1, 2]], np.uint8), PLATE_M)
    small = np.ones((10, 10), np.float32)
    with pytest.raises(ImageError, match="cam7"):
        cells.view(Radiance(small, small, np.full((10, 10), PixelStatus.OK, np.uint8)), "lamp0", "cam7", 0.0)
