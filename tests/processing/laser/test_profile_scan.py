"""Objects that move before a laser that stands, against the truth of a small forward model."""

from dataclasses import replace

import numpy as np
import pytest

from processing.errors import ImageError
from processing.laser.motion import Slide, Turn
from processing.laser.plane_fit import Plane
from processing.laser.profile_scan import ScanStatus, scan_profiles
from processing.laser.scan_check import check_motion, merged_points, pass_disagreement
from processing.laser.stripe import LaserColour
from tests.reference.profile_rig import AXIS_M, SLIDE, TURN, Ball, Cylinder, Step, setup, take_all


def matt(points):
    return np.full(points.shape[:-1], 0.7)


@pytest.fixture(scope="module")
def ball():
    """More than one turn of a patterned ball."""
    return take_all(setup(), Ball(), 66)


@pytest.fixture(scope="module")
def step():
    """A step that slides by, seven in ten of the light back from everywhere."""
    return take_all(setup(SLIDE), Step(), 40, albedo=matt)


@pytest.fixture(scope="module")
def scanned(ball):
    return scan_profiles(ball, setup())


def errors(scan, shape):
    return shape.distance(scan.points_m[scan.status == ScanStatus.MEASURED])


def test_a_turned_ball_is_round(ball, scanned):
    """Pattern of 5:1 and the limb included: a tenth of the stripe's 1.2 mm (2 sigma) at the median, half of it at most.

    The ball's size and place come out to a twentieth of a millimetre.
    """
    error = errors(scanned, Ball())
    assert len(error) > 8000
    assert np.median(np.abs(error)) < 0.12e-3
    assert np.abs(error).max() < 0.6e-3
    assert abs(error.mean()) < 0.05e-3


def test_noise_of_points_is_as_stated(step):
    """On matt planes, away from the step's edge: as large as the scan itself says, within a tenth, without bias."""
    scan = scan_profiles(step, setup(SLIDE))
    points, deviation = scan.points_m, scan.deviation_m
    inner = (scan.status == ScanStatus.MEASURED) & (np.abs(points[..., 0] - Step().edge_m) > 0.003)
    inner &= (np.abs(np.arange(points.shape[1]) - points.shape[1] / 2) < points.shape[1] / 2 - 8)[None]
    sigmas = Step().distance(points[inner]) / deviation[inner]
    assert inner.sum() > 4000
    assert 0.4 < np.mean(points[inner][:, 2] < 0.4) < 0.9  # both levels are seen
    assert np.sqrt(np.mean((sigmas - sigmas.mean()) ** 2)) == pytest.approx(1.0, abs=0.25)
    assert abs(sigmas.mean()) < 1.0


def test_a_slid_ball_is_round():
    shape = Ball((0.0, 0.0, 0.42), 0.03)
    motion = Slide(SLIDE.direction, 0.0015)
    scan = scan_profiles(take_all(setup(motion), shape, 24, albedo=matt), setup(motion))
    error = errors(scan, shape)
    assert len(error) > 1000
    assert np.median(np.abs(error)) < 0.05e-3


def test_a_turned_cylinder_is_straight_and_round():
    """A matt one, from all directions: a twentieth of a millimetre at the median, no bias along its axis."""
    coarse = setup(replace(TURN, step_rad=5 * TURN.step_rad))
    scan = scan_profiles(take_all(coarse, Cylinder(), 12, albedo=matt), coarse)
    error, height = errors(scan, Cylinder()), scan.points_m[scan.status == ScanStatus.MEASURED][:, 2]
    assert len(error) > 1500
    assert np.median(np.abs(error)) < 0.05e-3
    assert abs(np.polyfit(height, error, 1)[0]) < 1e-3


def test_a_stripe_along_rows_is_scanned_along_columns(ball, scanned):
    """The picture with rows and columns exchanged, of a world mirrored likewise, gives the mirrored points."""
    swap = [1, 0, 2]
    rig = setup()
    turned = Turn(AXIS_M[swap], TURN.direction[swap], -TURN.step_rad)
    plane = Plane(rig.plane.normal[swap], rig.plane.offset_m, np.nan, 0)
    other = replace(rig, matrix=rig.matrix[swap][:, swap], plane=plane, motion=turned)
    assert not other.upright
    scan = scan_profiles(ball.swapaxes(1, 2), other)
    np.testing.assert_array_equal(scan.status, scanned.status)
    np.testing.assert_allclose(scan.points_m, scanned.points_m * [1, -1, 1], atol=1e-9)
    np.testing.assert_array_equal(scan.colour, scanned.colour)


@pytest.mark.parametrize("factor", [16, 257])
def test_depth_of_bits_does_not_matter(ball, factor):
    """The same counts in 12 or 16 bits are the same points and colours."""
    one = scan_profiles(ball[:10], setup())
    other = scan_profiles(ball[:10].astype(np.uint16) * np.uint16(factor), setup())
    np.testing.assert_array_equal(other.status, one.status)
    np.testing.assert_allclose(other.points_m, one.points_m, atol=1e-9)
    assert np.abs(other.colour.astype(int) - one.colour).max() <= 1


def test_colours_are_the_objects_not_the_lasers(scanned):
    """Grey paint under a red laser stays grey."""
    shades = scanned.colour[scanned.status == ScanStatus.MEASURED].astype(int)
    assert np.median(np.ptp(shades, axis=1)) <= 4
    assert 20 < np.median(shades) < 50  # 60 counts of room light on paint of 0.6


def test_frames_without_a_stripe_measure_nothing_and_disturb_none(ball, scanned):
    dark = ball.copy()
    dark[[5, 6, 30]] = 0
    scan = scan_profiles(dark, setup())
    assert (scan.status[[5, 6, 30]] == ScanStatus.NO_STRIPE).all()
    kept = np.setdiff1d(np.arange(66), [4, 5, 6, 7, 29, 30, 31])
    assert np.mean(scan.status[kept] == scanned.status[kept]) > 0.999


def test_a_reflection_is_no_second_surface(ball):
    """A copy of the stripe of the same strength beside it: those scan lines are told and left out."""
    doubled = ball[:12].copy()
    extra = ball[:12, 60:110].astype(int)
    red = np.maximum(np.roll(extra[..., 0] - extra[..., 1], 40, axis=2), 0)
    doubled[:, 60:110, :, 0] = np.clip(doubled[:, 60:110, :, 0] + red, 0, 255)
    clean, scan = (scan_profiles(frames, setup(sigma_px=1.0)) for frames in (ball[:12], doubled))
    struck = clean.status[:, 64:106] == ScanStatus.MEASURED
    assert np.mean(scan.status[:, 64:106][struck] == ScanStatus.TWO_STRIPES) > 0.97
    rest = np.r_[0:50, 120:176]
    assert np.mean(scan.status[:, rest] == clean.status[:, rest]) > 0.99


def test_glints_are_left_out(ball):
    """Red spots in one frame in ten scan lines each: hardly one becomes a point."""
    rng = np.random.default_rng(2)
    spotted = ball[:30].copy()
    rows, columns = np.indices((5, 5)) - 2
    spot = 200 * np.exp(-0.5 * (rows**2 + columns**2))
    for frame in spotted:
        row, column = rng.integers(10, 160), rng.integers(5, 40)  # beside the ball
        frame[row - 2 : row + 3, column - 2 : column + 3, 0] = np.maximum(
            frame[row - 2 : row + 3, column - 2 : column + 3, 0], spot
        )
    scan = scan_profiles(spotted, setup(radius_m=0.06))
    wrong = np.abs(errors(scan, Ball())) > 1e-3
    assert scan.count(ScanStatus.ISOLATED) + scan.count(ScanStatus.OUT_OF_RANGE) > 20
    assert wrong.mean() < 0.01


def test_a_saturated_core_costs_little():
    """Four times as much light as the camera takes: at the median a tenth of the stripe, which is 2 mm wide then."""
    scan = scan_profiles(take_all(setup(), Ball(), 12, albedo=matt, laser=1500.0), setup())
    error = errors(scan, Ball())
    assert len(error) > 1200
    assert np.median(np.abs(error)) < 0.2e-3


@pytest.mark.parametrize("each", [False, True])
def test_what_is_red_without_the_laser_is_subtracted(each):
    """A red poster beside the object, stronger than the stripe, with one picture of it or with one for every frame."""
    rig = setup(radius_m=0.06)
    frames = take_all(rig, Ball(), 8, albedo=matt)
    poster = np.zeros_like(frames[0])
    poster[:, 20:23, 0] = 190
    posted = np.maximum(frames, poster)
    scan = scan_profiles(posted, rig, [poster] * (8 if each else 1))
    clean = scan_profiles(frames, rig)
    assert clean.count(ScanStatus.MEASURED) > 1000
    assert scan.count(ScanStatus.MEASURED) > 0.97 * clean.count(ScanStatus.MEASURED)
    assert scan_profiles(posted, rig).count(ScanStatus.MEASURED) < 0.3 * clean.count(ScanStatus.MEASURED)


def test_a_grey_laser_in_the_dark():
    frames = take_all(setup(), Ball(), 8, albedo=matt, room=0.0)
    scan = scan_profiles(frames[..., 0], setup(colour=LaserColour.GREY))
    assert scan.count(ScanStatus.MEASURED) > 800
    assert np.median(np.abs(errors(scan, Ball()))) < 0.1e-3
    with pytest.raises(ImageError, match="say grey"):
        scan_profiles(frames[..., 0], setup())


def test_later_turns_agree_where_the_step_is_right(ball, scanned):
    """To the noise where it is; a step wrong by a percent shows."""
    noise = float(np.nanmedian(scanned.deviation_m))
    assert pass_disagreement(scanned, TURN) < 4 * noise
    wrong = replace(TURN, step_rad=1.01 * TURN.step_rad)
    assert pass_disagreement(scan_profiles(ball, setup(wrong)), wrong) > 20 * noise
    assert np.isnan(pass_disagreement(scan_profiles(ball[:50], setup()), TURN))
    assert np.isnan(pass_disagreement(scanned, SLIDE))


@pytest.mark.parametrize("motion", [TURN, SLIDE])
def test_a_wrong_direction_is_found(ball, motion):
    frames = ball[:30] if motion is TURN else take_all(setup(SLIDE), Step(), 30)
    for stated, right in ((motion, True), (motion.reversed(), False)):
        rig = setup(stated)
        check = check_motion(frames, scan_profiles(frames, rig), rig)
        assert check.confirmed is right
        assert check.contradicted is not right


def test_a_dark_room_says_nothing_about_the_direction():
    frames = take_all(setup(), Ball(), 20, room=0.0)
    check = check_motion(frames, scan_profiles(frames, setup()), setup())
    assert not check.confirmed
    assert not check.contradicted
    assert np.isnan(check_motion(frames[:1], scan_profiles(frames[:1], setup()), setup()).stated)


def test_what_was_measured_twice_is_one_point(ball, scanned):
    """66 frames of 60 directions: a tenth of the points falls together, the surface stays."""
    points, colours = merged_points(scanned)
    measured = scanned.count(ScanStatus.MEASURED)
    assert 0.85 * measured < len(points) < 0.95 * measured
    assert colours.shape == points.shape
    assert np.median(np.abs(Ball().distance(points))) < 0.12e-3


def test_one_frame_is_one_profile(ball, scanned):
    scan = scan_profiles(ball[:1], setup())
    assert scan.count(ScanStatus.MEASURED) > 100
    assert np.abs(errors(scan, Ball())).max() < 0.6e-3
    assert len(merged_points(scan)[0]) > 100


@pytest.mark.parametrize(
    ("frames", "said"),
    [
        (np.zeros((0, 20, 30, 3), np.uint8), "no frames"),
        (np.zeros((5, 20, 30, 3), np.uint8), "no stripe"),
        ([np.zeros((20, 30, 3), np.uint8), np.zeros((30, 20, 3), np.uint8)], "one size"),
        ([np.zeros((20, 30, 3), np.uint8), np.zeros((20, 30, 3), np.uint16)], "one size"),
    ],
)
def test_sequences_that_measure_nothing_are_refused(frames, said):
    with pytest.raises(ImageError, match=said):
        scan_profiles(frames, setup())
    with pytest.raises(ImageError, match="one for all, or one for each"):
        scan_profiles(np.zeros((5, 20, 30, 3), np.uint8), setup(), [np.zeros((20, 30, 3), np.uint8)] * 3)


def test_noise_alone_has_no_stripe():
    rng = np.random.default_rng(0)
    with pytest.raises(ImageError, match="no stripe"):
        scan_profiles(rng.normal(60, 4, (6, 120, 160, 3)).clip(0, 255).astype(np.uint8), setup())
