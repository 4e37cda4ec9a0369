"""Cameras, boards and the turntable's axis in one adjustment: truth, bound, honest deviations, and bad input."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing import geometry
from processing.cameras.board import BoardView
from processing.cameras.calibration import survey
from processing.cameras.network import Shot
from processing.errors import CalibrationError
from tests.reference.camera_rig import (
    SAMPLE,
    SIZE,
    axis_errors,
    bounds_px,
    camera_rig,
    normalised_errors,
)

SEEDS = 10
ELEVATIONS_DEG, TURNS_DEG = (25, 45, 65, 88), (-120, -40, 60, 150)


@cache
def rig_and_views(noise_px, seed=1):
    rng = np.random.default_rng(seed)
    rig = camera_rig(rng, ELEVATIONS_DEG, TURNS_DEG, poses=6)
    return rig, rig.views(noise_px, rng)


@cache
def found(noise_px, seed=1):
    rig, views = rig_and_views(noise_px, seed)
    return survey(views, rig.sizes)


def changed(views, change):
    """The views, each replaced by change(camera, shot, view)."""
    return {name: {shot: change(name, shot, v) for shot, v in shots.items()} for name, shots in views.items()}


def sample_errors_px(rig, result):
    return np.stack([result.cameras[name].project(SAMPLE) - rig.sample_px(name) for name in rig.network.cameras])


def test_exact_corners_give_cameras_boards_and_axis():
    rig, _ = rig_and_views(0.0)
    result = found(0.0)
    assert np.abs(sample_errors_px(rig, result)).max() < 1e-3
    for pose, board in rig.network.boards.items():
        np.testing.assert_allclose(result.boards[pose], board, atol=1e-7)
    np.testing.assert_allclose(result.axis.direction, rig.network.boards[0][2, :3], atol=1e-7)
    np.testing.assert_allclose(result.axis.point_m, geometry.invert(rig.network.boards[0])[:3, 3], atol=1e-9)


def test_the_error_is_the_bound_and_the_deviations_are_honest():
    """Over ten rigs whose lenses are drawn from what is believed; 0.1 px noise."""
    errors, bounds, cameras, axes = [], [], [], []
    for seed in range(SEEDS):
        rig, _ = rig_and_views(0.1, seed)
        result = found(0.1, seed)
        errors.append(sample_errors_px(rig, result))
        bounds.append(bounds_px(rig, 0.1)[1])
        cameras.append([normalised_errors(rig.models[name], result.cameras[name]) for name in rig.network.cameras])
        axes.append(axis_errors(rig.network, result))
    # 650 points a camera, but of a few independent numbers each.
    assert np.sqrt(np.mean(np.square(errors)) / np.mean(np.square(bounds))) < 1.05
    assert 0.9 < np.sqrt(np.mean(np.square(cameras))) < 1.1  # 600 correlated errors
    assert 0.7 < np.sqrt(np.mean(np.square(axes))) < 1.3  # 40 errors: 11 % is one sigma


def test_corners_that_err_together_enlarge_the_deviations():
    """Displacements of 0.1 px that neighbouring corners of a picture share, as those of blur and shading are."""
    errors, alone = [], []
    told = [0, 1, *range(9, 15)]  # focal lengths, turn and shift: the corners tell them, not the priors
    for seed in range(4):
        rig, views = rig_and_views(0.0, seed)
        rng = np.random.default_rng(seed)

        def displace(_, __, view, rng=rng):
            apart = np.linalg.norm(view.uv_px[:, None] - view.uv_px[None], axis=2)
            shared = np.linalg.cholesky(np.exp(-((apart / 40.0) ** 2)) + 0.1 * np.eye(len(apart)))
            return BoardView(view.points_m, view.uv_px + 0.1 * shared @ rng.standard_normal(view.uv_px.shape))

        result = survey(changed(views, displace), rig.sizes)
        for name, true in rig.models.items():
            camera = result.cameras[name]
            off = normalised_errors(true, camera)
            errors.append(off[told])
            alone.append((off * camera.deviation / found(0.1, seed).cameras[name].deviation)[told])
    # 128 correlated errors. Independent corners of the same size would have claimed a third less.
    assert 0.75 < np.sqrt(np.mean(np.square(errors))) < 1.25
    assert np.sqrt(np.mean(np.square(alone))) > 1.2


def test_a_board_beside_the_axis_misleads_a_survey_without_turns():
    """What the turns are for: 0.2 mm and 0.05 deg of the hand, two orders over the noise."""
    rig, views = rig_and_views(0.1)
    flat = {name: {shot: v for shot, v in shots.items() if shot.turntable_rad == 0} for name, shots in views.items()}
    result = survey(flat, rig.sizes)
    assert result.axis is None
    np.testing.assert_array_equal(result.boards[0], np.eye(4))
    alone = np.sqrt(np.mean(sample_errors_px(rig, result) ** 2))
    assert alone > 10 * np.sqrt(np.mean(sample_errors_px(rig, found(0.1)) ** 2))


@settings(max_examples=3, deadline=None)
@given(st.permutations(range(4)), st.randoms(use_true_random=False))
def test_order_does_not_matter(cameras_in, random):
    _, views = rig_and_views(0.1)
    mixed = {}
    for i in cameras_in:
        shots = list(views[f"cam{i}"].items())
        random.shuffle(shots)
        mixed[f"cam{i}"] = dict(shots)
    result = survey(mixed, dict.fromkeys(mixed, SIZE))
    np.testing.assert_allclose(result.axis.direction, found(0.1).axis.direction, atol=1e-8)
    for name, camera in found(0.1).cameras.items():
        np.testing.assert_allclose(result.cameras[name].project(SAMPLE), camera.project(SAMPLE), atol=1e-4)


@settings(max_examples=3, deadline=None)
@given(st.sampled_from([1e-3, 1e3, 0.0254]))
def test_the_unit_of_length_does_not_matter(unit):
    rig, views = rig_and_views(0.1)
    scaled = changed(views, lambda _, __, v: BoardView(v.points_m * unit, v.uv_px))
    result, metric = survey(scaled, rig.sizes), found(0.1)
    np.testing.assert_allclose(result.axis.point_m / unit, metric.axis.point_m, atol=1e-9)
    for name, camera in metric.cameras.items():
        np.testing.assert_allclose(result.cameras[name].centre_m / unit, camera.centre_m, atol=1e-6)
        np.testing.assert_allclose(result.cameras[name].lens.matrix, camera.lens.matrix, atol=1e-2)


def test_the_turntables_zero_is_where_it_says():
    """Every angle by 100 deg more: the same cameras, and the sample's frame turned back by as much."""
    rig, views = rig_and_views(0.1)
    more = np.radians(100)
    later = {n: {Shot(s.pose, s.turntable_rad + more): v for s, v in shots.items()} for n, shots in views.items()}
    result = survey(later, rig.sizes)
    back = geometry.rotation_z(more)
    for name, camera in found(0.1).cameras.items():
        np.testing.assert_allclose(result.cameras[name].rig_from_camera, back @ camera.rig_from_camera, atol=1e-7)
        # A sample point lies where the table, turned by the angle that the shots name, has brought it.
        points = geometry.transform_points(back, SAMPLE)
        np.testing.assert_allclose(result.cameras[name].project(points), camera.project(SAMPLE), atol=1e-4)


def test_azimuth_zero_is_where_the_arc_stands():
    turned = geometry.rotation_z(0.4)
    result = found(0.0)
    askew = replace(
        result,
        cameras={n: replace(c, rig_from_camera=turned @ c.rig_from_camera) for n, c in result.cameras.items()},
        boards={pose: turned @ board for pose, board in result.boards.items()},
    ).facing(list(result.cameras))
    azimuths = [np.arctan2(camera.centre_m[1], camera.centre_m[0]) for camera in askew.cameras.values()]
    assert np.abs(azimuths[:3]).max() < 0.01  # the fourth looks almost straight down
    for name, camera in askew.cameras.items():
        np.testing.assert_allclose(
            camera.project(geometry.transform_points(askew.boards[0], SAMPLE)),
            result.cameras[name].project(geometry.transform_points(result.boards[0], SAMPLE)),
            atol=1e-6,
        )
    assert askew.axis is result.axis


def test_five_in_a_hundred_wrong_corners_do_little_harm():
    rig, views = rig_and_views(0.1)
    rng = np.random.default_rng(9)

    def spoil(_, __, view):
        wrong = rng.random((len(view.uv_px), 1)) < 0.05
        return BoardView(view.points_m, view.uv_px + wrong * rng.uniform(-30, 30, view.uv_px.shape))

    result = survey(changed(views, spoil), rig.sizes)
    clean = np.sqrt(np.mean(sample_errors_px(rig, found(0.1)) ** 2))
    assert np.sqrt(np.mean(sample_errors_px(rig, result) ** 2)) < 1.5 * clean
    left_out = np.mean(np.concatenate([~r.accepted for r in result.residuals.values()]))
    assert 0.03 < left_out < 0.07


def test_corners_that_are_no_numbers_are_left_out():
    rig, views = rig_and_views(0.1)

    def spoil(name, _, view):
        uv_px = view.uv_px.copy()
        uv_px[3:5, 0] = np.nan, np.inf
        return BoardView(view.points_m, uv_px)

    def without(_, __, view):
        return BoardView(np.delete(view.points_m, [3, 4], axis=0), np.delete(view.uv_px, [3, 4], axis=0))

    spoilt, clean = survey(changed(views, spoil), rig.sizes), survey(changed(views, without), rig.sizes)
    for name, camera in clean.cameras.items():
        np.testing.assert_allclose(spoilt.cameras[name].lens.matrix, camera.lens.matrix, rtol=1e-9)


def test_a_camera_blind_in_pose_zero_is_placed_by_the_others():
    rig, views = rig_and_views(0.1)
    blind = {name: dict(shots) for name, shots in views.items()}
    blind["cam0"] = {shot: view for shot, view in views["cam0"].items() if shot.pose != 0}
    result = survey(blind, rig.sizes)
    assert np.abs(result.cameras["cam0"].project(SAMPLE) - rig.sample_px("cam0")).max() < 0.3


def test_mirrored_pictures_are_refused():
    rig, views = rig_and_views(0.1)

    def flip(name, _, view):
        mirrored = BoardView(view.points_m, [SIZE[1] - 1, 0] + view.uv_px * [-1, 1])
        return mirrored if name == "cam1" else view

    flipped = changed(views, flip)
    with pytest.raises(CalibrationError, match=r"cam1: .*behind"):
        survey(flipped, rig.sizes)


def test_angles_that_are_not_the_tables_own_are_refused():
    rig, views = rig_and_views(0.1)
    against = {n: {Shot(s.pose, -s.turntable_rad): v for s, v in shots.items()} for n, shots in views.items()}
    with pytest.raises(CalibrationError, match="turned otherwise"):
        survey(against, rig.sizes)
    still = {n: {s: shots[Shot(s.pose)] for s in shots} for n, shots in views.items()}
    with pytest.raises(CalibrationError, match="did not turn"):
        survey(still, rig.sizes)


def test_a_turn_too_small_for_an_axis_is_refused():
    rng = np.random.default_rng(2)
    rig = camera_rig(rng, ELEVATIONS_DEG, turns_deg=(3.0,), poses=6)
    with pytest.raises(CalibrationError, match="axis"):
        survey(rig.views(0.1, rng), rig.sizes)


def test_two_opposite_angles_are_enough():
    rng = np.random.default_rng(2)
    rig = camera_rig(rng, ELEVATIONS_DEG, turns_deg=(180.0,), poses=6)
    result = survey(rig.views(0.1, rng), rig.sizes)
    assert np.abs(axis_errors(rig.network, result)).max() < 4


def test_boards_that_were_never_tilted_are_refused():
    rng = np.random.default_rng(3)
    rig = camera_rig(rng, ELEVATIONS_DEG, TURNS_DEG, poses=6)
    flat = {pose: geometry.rigid(np.eye(3), [*rng.uniform(-0.01, 0.01, 2), 0]) for pose in range(1, 6)}
    parallel = replace(rig, network=replace(rig.network, boards=rig.network.boards | flat))
    with pytest.raises(CalibrationError, match=r"tilt"):
        survey(parallel.views(0.1, rng), rig.sizes)


def test_an_extremely_long_lens_is_refused():
    """Twenty times the focal length and distance: perspective is almost gone, and with it what tells them apart."""
    rng = np.random.default_rng(4)
    rig = camera_rig(rng, ELEVATIONS_DEG, TURNS_DEG, poses=6)

    def far(camera):
        matrix = camera.lens.matrix * np.array([[20, 1, 1], [1, 20, 1], [1, 1, 1]])
        pose = camera.camera_from_rig.copy()
        pose[2, 3] *= 20
        return replace(camera, lens=replace(camera.lens, matrix=matrix), camera_from_rig=pose)

    distant = replace(rig, network=replace(rig.network, cameras={n: far(c) for n, c in rig.network.cameras.items()}))
    with pytest.raises(CalibrationError, match=r"focal length"):
        survey(distant.views(0.1, rng), rig.sizes)
