"""What goes wrong during a sweep ends in a status or in a true variance: never in an error, never in silence."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.laser.laser_plane import SweepStatus, fit_sweep
from processing.laser.mdf import Sweep, SweepResult, mdf_from_sweeps, measure_sweep
from processing.laser.range_image import RangeStatus
from processing.laser.space_time import PeakStatus
from tests.processing.laser.test_laser_plane import RIG, TRUE, reference
from tests.reference.stripe_rig import HOLDER, SENSOR, Rig, bump, camera_at, expose

FRAMES = 96
NUMBERS = np.arange(FRAMES, dtype=float)


@dataclass(frozen=True)
class Scene:
    """A rig, its stripe's light (t, h, w) in electrons, the true displacement: NaN where the laser does not reach."""

    rig: Rig
    light_e: np.ndarray
    truth: np.ndarray

    def frames(self, light_e=None, seed=1):
        """The light, or other light, as a camera counts it."""
        return expose(self.light_e if light_e is None else light_e, np.random.default_rng(seed))

    def sweep(self, frames, times=None):
        rig = self.rig
        return Sweep("view", frames, SENSOR, rig.camera, rig.rig_from_sample, rig.mount, times)

    def measure(self, frames, times=None) -> SweepResult:
        return measure_sweep(self.sweep(frames, times), HOLDER)

    def normalised(self, result):
        """Errors over their standard deviations at all measured pixels that the laser reaches."""
        error = (result.image.displacement_m - self.truth) / np.sqrt(result.image.variance_m2)
        return error[np.isfinite(error)]


def scene_of(rig):
    points, displacement = rig.hits()
    lit = rig.lit(points)
    return Scene(rig, rig.electrons(points, lit), np.where(lit, displacement, np.nan))


@pytest.fixture(scope="module")
def scene():
    return scene_of(Rig(camera_at(60), bump))


@pytest.fixture(scope="module")
def small():
    return scene_of(Rig(camera_at(60, 0.25), bump))


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def assert_true_variance(scene, result, least=0.8, most=1.2):
    """Normalised errors near one, and none that a normal law would not know; `most` of over a thousand pixels."""
    errors = scene.normalised(result)
    assert len(errors) > 500
    assert least < rms(errors) < most
    assert np.mean(np.abs(errors) > 5) < 0.005


def assert_consistent(result):
    """A number where the status says so and nowhere else; each with a variance that knows less than the box does."""
    measured = result.image.status == RangeStatus.MEASURED
    assert (np.isfinite(result.image.displacement_m) == measured).all()
    assert (result.image.variance_m2[measured] > 0).all()
    assert (result.image.variance_m2[measured] <= HOLDER.depth_m**2 / 12).all()
    peaks = result.peaks
    assert (np.isfinite(peaks.time_frames) == (peaks.status == PeakStatus.OK)).all()


# ---- light --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("times", [2, 4, 40])
def test_a_saturated_stripe_is_measured_by_its_flanks(scene, times):
    """Up to 360 000 electrons, where the counts end at 15 000; some of the brightest pixels have no flanks left."""
    result = scene.measure(scene.frames(times * scene.light_e))
    assert result.laser.status == SweepStatus.OK
    assert result.completeness > 0.75
    assert_true_variance(scene, result)
    assert_consistent(result)


@pytest.mark.parametrize("level_dn", [None, 0, 4095, 65535])
def test_without_a_stripe_there_is_no_number(scene, level_dn):
    """Noise about black, and frames of one value each."""
    frames = scene.frames(0 * scene.light_e) if level_dn is None else np.full(scene.light_e.shape, level_dn, np.uint16)
    result = scene.measure(frames)
    assert result.laser.status == SweepStatus.NO_STRIPE
    assert not (result.image.status == RangeStatus.MEASURED).any()
    assert_consistent(result)
    mdf, _ = mdf_from_sweeps([scene.sweep(frames)], HOLDER, 8)
    assert np.isnan(mdf.displacement_m).all()


@pytest.mark.parametrize("share", [0.6, 0.8, 1.0])
def test_two_equal_stripes_are_no_measurement(scene, share):
    """A second reflection or a second laser, 25 frames behind: nobody knows which of the two is meant."""
    result = scene.measure(scene.frames(scene.light_e + share * np.roll(scene.light_e, 25, axis=0)))
    looked_at = result.peaks.status != PeakStatus.NOT_WANTED
    assert np.mean(result.peaks.status[looked_at] == PeakStatus.DOUBLE) > 0.3
    assert not (result.image.status == RangeStatus.MEASURED).any()


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_a_weak_second_stripe_changes_nothing(scene, share):
    result = scene.measure(scene.frames(scene.light_e + share * np.roll(scene.light_e, 25, axis=0)))
    assert result.completeness > 0.9
    assert_true_variance(scene, result)


def test_a_flash_is_no_stripe(scene):
    """Three frames of light everywhere: all pixels peak at once, and no plane passes through all of them."""
    flash = np.where(np.abs(NUMBERS - 49) < 2, 3000.0, 0.0)[:, None, None]
    result = scene.measure(scene.frames(scene.light_e + flash))
    assert result.completeness < 0.05
    assert_consistent(result)


LAMPS = {
    "switched on": 300.0 * (NUMBERS >= 48),
    "switched on brightly": 3000.0 * (NUMBERS >= 48),
    "turned up": 2000.0 * NUMBERS / FRAMES,
    "swaying": 1000.0 + 1000.0 * np.sin(NUMBERS / 3),
    "flickering": 300.0 * np.random.default_rng(8).random(FRAMES),
}


@pytest.mark.parametrize("lamp_e", LAMPS.values(), ids=LAMPS.keys())
def test_a_lamp_that_moves_during_a_sweep_makes_nothing_surely_wrong(scene, lamp_e):
    """Up to a third of the stripe on white, more than the stripe where it is not red: true variances, or no numbers."""
    result = scene.measure(scene.frames(scene.light_e + lamp_e[:, None, None]))
    errors = scene.normalised(result)
    assert_consistent(result)
    assert np.count_nonzero(np.abs(errors) > 5) <= 0.005 * len(errors)
    assert len(errors) < 100 or rms(errors) < 1.2


# ---- frames and times ---------------------------------------------------------------------------------------------

LOST = {"one": [48], "five": [20, 40, 41, 60, 77], "ten in a row": list(range(40, 50))}


@pytest.mark.parametrize("lost", LOST.values(), ids=LOST.keys())
def test_frames_that_are_known_to_be_lost_cost_only_their_own(scene, lost):
    kept = np.delete(NUMBERS, lost)
    result = scene.measure(scene.frames()[kept.astype(int)], kept)
    assert result.completeness > 0.95 - 2.5 * len(lost) / FRAMES
    assert_true_variance(scene, result)
    assert_consistent(result)


def widening(clean, result, times):
    """How much larger standard deviations are than without the fault: within two frames of it, and beyond eight."""
    ratio = np.sqrt(result.image.variance_m2 / clean.image.variance_m2)
    away = np.min(np.abs(clean.peaks.time_frames[..., None] - np.array(times)), axis=-1)
    return np.nanquantile(ratio[away < 2], 0.75), np.nanmedian(ratio[away > 8])


def assert_shown(scene, frames, times):
    """What was measured near the fault is told to be uncertain, what is far from it is not, and both are true."""
    clean, result = scene.measure(scene.frames()), scene.measure(frames)
    near, far = widening(clean, result, times)
    assert near > 1.4
    assert far < 1.1
    assert_true_variance(scene, result)
    assert_consistent(result)


@pytest.mark.parametrize("lost", LOST.values(), ids=LOST.keys())
def test_frames_that_are_lost_in_silence_show_on_the_holder(scene, lost):
    """The white frame's times disagree about the gap."""
    assert_shown(scene, np.delete(scene.frames(), lost, axis=0), lost)


@pytest.mark.parametrize("doubled", [[48], [20, 40, 60]])
def test_frames_that_are_delivered_twice_show_on_the_holder(scene, doubled):
    assert_shown(scene, np.insert(scene.frames(), doubled, scene.frames()[doubled], axis=0), doubled)


def test_frozen_frames_show_on_the_holder(scene):
    """The frame before instead of this one; a session refuses such bursts, other people's data may have them."""
    frames = scene.frames()
    frames[60:64] = frames[59]
    assert_shown(scene, frames, [60, 61, 62, 63])


def test_a_sweep_may_run_backward(scene):
    """Reversed frames are the same measurement, up to the mirrored clock."""
    one, other = scene.measure(scene.frames()), scene.measure(scene.frames()[::-1])
    both = np.isfinite(one.image.displacement_m) & np.isfinite(other.image.displacement_m)
    assert np.mean(both == np.isfinite(one.image.displacement_m)) > 0.99
    difference = (one.image.displacement_m - other.image.displacement_m)[both]
    assert rms(difference / np.sqrt(one.image.variance_m2[both])) < 0.1
    assert_true_variance(scene, other)


class LateRig(Rig):
    """Every frame is late or early by its own part of the interval."""

    LATE = np.concatenate([[0.0], np.random.default_rng(4).normal(0, 0.15, FRAMES - 1)])

    def fan(self, time):
        return super().fan(time + self.LATE[np.rint(time).astype(int)])


@pytest.fixture(scope="module")
def late_frames(scene):
    rig = LateRig(scene.rig.camera, scene.rig.surface)
    points, _ = rig.hits()
    return scene.frames(rig.electrons(points, rig.lit(points)))


def test_the_true_times_of_late_frames_are_used(scene, late_frames):
    """Told when each frame was taken, a jittering camera is as good as a steady one; untold, it says what it is not."""
    steady = scene.measure(scene.frames())
    told = scene.measure(late_frames, NUMBERS + LateRig.LATE)
    untold = scene.measure(late_frames)
    error_m = [np.nanmedian(np.abs(r.image.displacement_m - scene.truth)) for r in (steady, told, untold)]
    assert error_m[1] < 1.1 * error_m[0]
    assert error_m[2] > 1.03 * error_m[0]
    for result in (told, untold):
        assert_true_variance(scene, result)


@pytest.mark.parametrize("count", [1, 2, 3, 9])
def test_a_sweep_of_few_frames_is_none(scene, count):
    middle = slice(48 - count // 2, 48 - count // 2 + count)
    result = scene.measure(scene.frames()[middle])
    assert result.laser.status == SweepStatus.NO_STRIPE
    assert_consistent(result)


def test_half_a_sweep_is_half_of_the_sample(scene):
    result = scene.measure(scene.frames()[:48])
    assert 0.3 < result.completeness < 0.7
    assert_true_variance(scene, result)


@pytest.mark.timeout(120)
def test_ten_thousand_frames_of_which_few_show_the_stripe(small):
    """Frame by frame, as a camera that ran all night would deliver them."""
    dark, count = np.zeros(small.light_e.shape[1:]), 10_000
    rng = np.random.default_rng(6)
    night = (expose(small.light_e[k] if 0 <= k < FRAMES else dark, rng) for k in range(-count // 2, count // 2))
    result = small.measure(night)
    assert result.laser.status == SweepStatus.OK
    assert result.laser.last - result.laser.first < FRAMES
    errors = small.normalised(result)
    assert len(errors) > 100
    assert 0.75 < rms(errors) < 1.25  # four standard errors


def test_planes_of_a_sweep_of_many_frames_stay_small_work():
    """Five thousand frames with the stripe in each: the spline has fewer pieces, and still holds the laser."""
    points, times = reference(RIG)
    noisy = 50 * times + np.random.default_rng(7).normal(0, 0.5, times.size)
    sweep = fit_sweep(points, noisy, np.full(times.size, 0.25), RIG.mount)
    assert sweep.status == SweepStatus.OK
    assert len(sweep.local_excess_rad) <= 400 < sweep.last - sweep.first
    assert (np.abs(sweep.fan - TRUE) < 4 * sweep.deviation).all()


def test_a_bad_sweep_does_not_spoil_a_view(scene):
    """Merged with a clean one: a sweep without a stripe, one with lost frames, one with a flash."""
    flash = np.where(np.abs(NUMBERS - 49) < 2, 3000.0, 0.0)[:, None, None]
    clean = scene.sweep(scene.frames())
    bad = [
        scene.frames(0 * scene.light_e, seed=2),
        np.delete(scene.frames(seed=3), LOST["ten in a row"], axis=0),
        scene.frames(scene.light_e + flash, seed=4),
    ]
    (alone,), (together,) = (
        mdf_from_sweeps([clean, *(scene.sweep(frames) for frames in others)], HOLDER, 16)[1] for others in ([], bad)
    )
    error_m = [view.merged.displacement_m - scene.truth for view in (alone, together)]
    assert np.isfinite(error_m[1]).sum() >= np.isfinite(error_m[0]).sum()
    assert np.nanmedian(np.abs(error_m[1])) < 1.1 * np.nanmedian(np.abs(error_m[0]))
    normalised = error_m[1] / np.sqrt(together.merged.variance_m2)
    assert 0.8 < rms(normalised[np.isfinite(normalised)]) < 1.2


@pytest.mark.parametrize("lamp_e", [300.0, 3000.0])
def test_a_lamp_that_stays_on_costs_only_its_noise(scene, lamp_e):
    result = scene.measure(scene.frames(scene.light_e + lamp_e))
    assert result.completeness > 0.5
    assert_true_variance(scene, result)


# ---- anything -----------------------------------------------------------------------------------------------------


@given(st.data())
@settings(max_examples=25, deadline=None)
def test_whatever_becomes_of_the_frames_there_is_an_answer(small, data):
    """Lost, doubled, swapped, brightened, blackened, in any mixture: a status or a number for every pixel, no error."""
    order = data.draw(st.lists(st.integers(0, FRAMES - 1), min_size=1, max_size=FRAMES + 20))
    frames = small.frames()[np.array(order) if data.draw(st.booleans()) else np.sort(order)]
    for index in data.draw(st.lists(st.integers(0, len(frames) - 1), max_size=5)):
        frames[index] = data.draw(st.sampled_from([0, 256, 4095, 65535]))
    lamp_e = data.draw(st.floats(0, 10_000)) * data.draw(st.sampled_from([0.0, 1.0])) * np.arange(len(frames))
    frames += np.minimum(lamp_e / 4, 3000).astype(np.uint16)[:, None, None] * (frames < 4096)
    known = np.cumsum(data.draw(st.lists(st.floats(0.01, 30), min_size=len(frames), max_size=len(frames))))
    assert_consistent(small.measure(frames, known if data.draw(st.booleans()) else None))
