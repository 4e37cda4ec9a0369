"""Lamps from highlights: within their deviations, whatever is hidden, doubled or dead."""

from dataclasses import replace

import numpy as np
import pytest

from processing.errors import CalibrationError
from processing.geometry import intersect_plane, rotate, rotation_z
from processing.lamps.calibration import measure_lamps
from processing.lamps.camera_doubt import doubted_eye, reflection_image, reflection_points
from processing.lamps.mirror import Sighting, locate_lamps
from processing.lamps.model import LampStatus
from simulators.glint import reflection_points as simulated_reflection
from simulators.layout import MirrorLayout
from tests.reference.lamp_rig import BALL, LampRig, angle_deg, spot

RIG = LampRig.of(1)
SEEDS = 8


def located(sightings, rig=RIG, cameras=None):
    return locate_lamps(sightings, cameras or rig.cameras, rig.nominal, BALL)


def errors_deg(fit, rig=RIG):
    pairs = zip(fit.places.names, fit.places.positions_m, strict=True)
    return {name: angle_deg(place, rig.position(name)) for name, place in pairs}


def test_reflection_is_that_of_the_simulators():
    """Two programs, one law."""
    mirror = MirrorLayout(centre_m=(0.001, 0.002, 0.02))
    sources, eye = np.array([[0.5, 0.3, 0.6], [-0.7, 0.1, 0.4]]), np.array([0.6, 0.0, 0.8])
    ours = reflection_points(np.array(mirror.centre_m), mirror.radius_m, sources, eye)
    np.testing.assert_allclose(ours, simulated_reflection(mirror, sources, eye), atol=1e-12)


def test_a_doubted_eye_sees_the_plane_as_before_and_the_ball_from_elsewhere():
    said, ball = RIG.cameras["cam4"], (np.array([0.003, -0.002, 0.02]), 0.02)
    sources = np.array([[0.5, 0.3, 0.6], [-0.3, 0.5, 0.7]])
    np.testing.assert_allclose(doubted_eye(said, np.zeros(7)), said.centre_m, atol=1e-12)
    doubt = np.array([0, 0, 0, 0, 0.02, 0.001, -0.002])
    eye = doubted_eye(said, doubt)
    assert np.linalg.norm(eye) == pytest.approx(1.02 * np.linalg.norm(said.centre_m))
    assert angle_deg(eye, said.centre_m) == pytest.approx(np.degrees(np.hypot(0.001, 0.002)), rel=1e-3)
    at = reflection_points(*ball, sources, eye)
    met = intersect_plane(eye, at - eye, (0, 0, 1), 0.0)
    np.testing.assert_allclose(reflection_image(said, doubt, ball, sources), said.project(met), atol=1e-9)


def test_shift_scale_and_roll_are_those_of_the_image():
    said, ball = RIG.cameras["cam4"], (np.array([0.003, -0.002, 0.02]), 0.02)
    sources = np.array([[0.5, 0.3, 0.6], [-0.3, 0.5, 0.7]])
    plain, middle = reflection_image(said, np.zeros(7), ball, sources), said.project(np.zeros(3))
    np.testing.assert_allclose(plain, said.project(reflection_points(*ball, sources, said.centre_m)), atol=1e-6)
    moved = reflection_image(said, np.array([0.3, -0.2, 0.01, np.pi / 2, 0, 0, 0]), ball, sources)
    off = plain - middle
    np.testing.assert_allclose(moved - middle, 1.01 * np.column_stack([-off[:, 1], off[:, 0]]) + [0.3, -0.2], atol=1e-9)


def test_truth_lies_within_the_deviations():
    """Over rigs, noise, labels and seats, and cameras that are off by what their calibration leaves open."""
    normalised, worst = [], []
    for seed in range(SEEDS):
        rig, rng = LampRig.of(seed), np.random.default_rng(seed)
        nominal, ball = rig.believed(rng)
        sightings = rig.sightings(rng, turn_sigma_rad=np.radians(0.005))
        fit = locate_lamps(sightings, rig.cameras, nominal, ball)
        for name in fit.places.names:
            off = fit.places.positions_m[fit.places.names.index(name)] - rig.position(name)
            normalised.append(off @ np.linalg.solve(fit.places.covariance(name), off) / 3)
        worst.append(max(errors_deg(fit, rig).values()))
    # 8 rigs of 9 lamps that share cameras: about 100 independent numbers, whose root mean square scatters by 7 %.
    assert 0.85 < np.sqrt(np.mean(normalised)) < 1.15
    assert np.sqrt(np.mean(np.square(worst))) < 0.1


def test_the_order_of_sightings_does_not_matter():
    sightings = RIG.sightings(np.random.default_rng(0))
    first, second = located(sightings), located(sightings[::-1])
    np.testing.assert_allclose(first.places.positions_m, second.places.positions_m, atol=1e-7)
    np.testing.assert_allclose(first.residual_px, second.residual_px[::-1], atol=1e-5)


def test_directions_do_not_depend_on_the_cameras_distance():
    """Focal lengths and distances are known to 1 or 2 % only, the plane's image being right; directions feel little."""
    rng, sightings = np.random.default_rng(0), []
    farther = dict(zip(RIG.cameras, (0.02, -0.015, 0.01), strict=True))
    ball = (np.array(RIG.layout.mirror.centre_m), BALL.radius_m)
    for plain in RIG.sightings(rng):
        doubt = np.array([0, 0, 0, 0, farther[plain.camera], 0, 0])
        source = rotate(rotation_z(plain.angle_rad), RIG.position(plain.lamp))
        uv_px = reflection_image(RIG.cameras[plain.camera], doubt, ball, source[None])[0] + rng.normal(0, 0.01, 2)
        sightings.append(replace(plain, spots=(spot(uv_px, 0.01),)))
    models, _ = measure_lamps(RIG.nominal, sightings, located(sightings), RIG.plate_views(rng), 0.9)
    for name, model in models.items():
        assert angle_deg(model.position_m, RIG.position(name)) < (0.03 if name != "led" else 0.1)


def test_lamps_hidden_from_some_cameras_are_found_by_the_others():
    sightings = [replace(s, spots=()) if s.camera == "cam1" else s for s in RIG.sightings(np.random.default_rng(1))]
    fit = located(sightings)
    assert max(errors_deg(fit).values()) < 0.15
    assert np.isnan(fit.residual_px[[s.camera == "cam1" for s in sightings]]).all()


def test_a_brighter_reflection_elsewhere_is_not_taken_for_the_lamp():
    """Interreflections in every fifth picture, brighter than the lamp itself in it."""
    sightings = RIG.sightings(np.random.default_rng(2))
    doubled = [
        replace(s, spots=(spot(s.spots[0].uv_px + np.array([7.0, -4.0]), 0.01), *s.spots)) if number % 5 == 0 else s
        for number, s in enumerate(sightings)
    ]
    plain, fit = located(sightings), located(doubled)
    # a hundredth of the deviations: where iterations end depends on where they begin
    np.testing.assert_allclose(fit.places.positions_m, plain.places.positions_m, atol=5e-5)


def test_highlights_in_the_wrong_place_lose_their_weight():
    sightings = RIG.sightings(np.random.default_rng(3))
    spoilt = [
        replace(s, spots=(spot(s.spots[0].uv_px + np.array([0.8, 0.5]), 0.01),)) if number % 9 == 4 else s
        for number, s in enumerate(sightings)
    ]
    fit = located(spoilt)
    assert (fit.weight[4::9] == 0).all()
    assert max(errors_deg(fit).values()) < 0.15


def test_a_dead_lamp_is_not_measured_and_harms_no_other():
    sightings = RIG.sightings(np.random.default_rng(4))
    dead = [replace(s, spots=()) if s.lamp == "lamp3" else s for s in sightings]
    fit = located(dead)
    models, _ = measure_lamps(RIG.nominal, dead, fit, [], 1.0)
    assert models["lamp3"].status == LampStatus.NOT_MEASURED
    np.testing.assert_allclose(models["lamp3"].position_m, RIG.nominal["lamp3"].position_m)
    others = {name: model for name, model in models.items() if name != "lamp3"}
    assert all(model.status != LampStatus.NOT_MEASURED for model in others.values())
    assert max(angle_deg(model.position_m, RIG.position(name)) for name, model in others.items()) < 0.15


def test_one_camera_tells_directions_but_hardly_distances():
    sightings = [s for s in RIG.sightings(np.random.default_rng(5)) if s.camera == "cam4"]
    fit = located(sightings)
    models, _ = measure_lamps(RIG.nominal, sightings, fit, [], 1.0)
    every = LampRig.of(1).sightings(np.random.default_rng(5))
    together, _ = measure_lamps(RIG.nominal, every, located(every), [], 1.0)
    for name, model in models.items():
        assert angle_deg(model.position_m, RIG.position(name)) < 0.5
        assert model.distance_deviation_m > together[name].distance_deviation_m
        off = model.position_m - RIG.position(name)
        assert off @ np.linalg.solve(model.covariance_m2, off) / 3 < 9


def test_one_sighting_measures_nothing():
    """The ball may lie 5 mm off its seat, a quarter of its radius: one highlight may be of a lamp 25 deg away."""
    one = RIG.sightings(np.random.default_rng(6))[:1]
    models, _ = measure_lamps(RIG.nominal, one, located(one), [], 1.0)
    assert all(model.status == LampStatus.NOT_MEASURED for model in models.values())


def test_one_camera_and_one_lamp_assume_the_distance():
    one = [s for s in RIG.sightings(np.random.default_rng(6)) if s.lamp == "lamp3" and s.camera == "cam4"]
    models, _ = measure_lamps(RIG.nominal, one, located(one), [], 1.0)
    assert models["lamp3"].status == LampStatus.DISTANCE_ASSUMED
    assert angle_deg(models["lamp3"].position_m, RIG.position("lamp3")) < 0.5


def test_nothing_seen_is_one_clear_error():
    with pytest.raises(CalibrationError, match="no lamp was seen"):
        located([Sighting("lamp0", "cam1", 0.5, ())])


def test_a_highlight_that_nothing_explains_is_one_clear_error():
    sightings = RIG.sightings(np.random.default_rng(7))
    sightings[3] = replace(sightings[3], spots=(spot(np.array([1e6, 1.0]), 0.01),))
    with pytest.raises(CalibrationError, match="explain the highlights"):
        located(sightings)


@pytest.mark.parametrize("change", [{"camera": "cam9"}, {"lamp": "lamp99"}])
def test_strangers_are_named(change):
    sighting = replace(RIG.sightings(np.random.default_rng(7))[0], **change)
    with pytest.raises(CalibrationError, match=next(iter(change.values()))):
        located([sighting])


def test_positions_turn_with_their_carrier():
    models, _ = measure_lamps(RIG.nominal, [], None, [], 1.0)
    lamp = models["lamp2"]
    np.testing.assert_allclose(lamp.position(0.7), rotate(rotation_z(0.7), lamp.position_m))
    assert np.linalg.norm(lamp.direction(0.7)) == pytest.approx(1)
