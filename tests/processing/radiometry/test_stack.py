"""One bracketed stack from frames to radiance, on its own and on frames of the simulated rig."""

import numpy as np
import pytest

from processing.errors import ImageError
from processing.formats.raw import map_raw
from processing.radiometry.adaptive import SHARE
from processing.radiometry.alignment import ShiftStatus
from processing.radiometry.exposure import TimesVerdict
from processing.radiometry.hdr import PixelStatus, merge_exposures
from processing.radiometry.stack import Exposures, MergeOptions, merge_stack
from simulators.optics import Optics
from simulators.pose import Pose
from tests.processing.radiometry.test_adaptive import rms_by_tile
from tests.processing.radiometry.test_exposure import FLICKER, SCENE
from tests.processing.radiometry.test_hdr import EXPOSURE_S, SENSOR, photograph


def merged(raw, times, **options):
    return merge_stack(Exposures(list(raw), times, list("abcdefgh"[: len(raw)]), SENSOR), MergeOptions(**options))


def test_flicker_of_one_percent_leaves_no_bias():
    """Without the correction the radiance would be off by up to a percent, three times its own deviation."""
    raw = photograph(SCENE, EXPOSURE_S * FLICKER, np.random.default_rng(0))
    found = merged(raw, EXPOSURE_S)
    assert found.times.verdict == TimesVerdict.CORRECTED
    mean_s = np.exp(np.log(FLICKER).mean())  # the gauge: stated times are right on average
    error = (found.radiance.value / mean_s - SCENE)[SCENE > 100] / SCENE[SCENE > 100]
    assert abs(error.mean()) < 5e-4
    assert abs((merge_exposures(raw, EXPOSURE_S, SENSOR).value / mean_s - SCENE)[SCENE > 2e4].mean() / 3e4) > 1e-3


EXTREMES = {
    "all dark": (np.zeros((96, 128)), EXPOSURE_S),
    "all saturated": (np.full((96, 128), 1e9), EXPOSURE_S),
    "two frames": (SCENE, EXPOSURE_S[[1, 3]]),
    "one frame": (SCENE, EXPOSURE_S[2:3]),
    "a ratio of a million": (10 ** np.random.default_rng(0).uniform(0, 9, (96, 128)), np.array([1e-6, 1.0])),
    "a hundred frames": (SCENE, np.geomspace(1e-3, 2, 100)),
    "smaller than a tile": (SCENE[:10, :14], EXPOSURE_S),
}


@pytest.mark.parametrize("name", EXTREMES)
def test_any_stack_is_merged_like_the_whole_by_the_stated_times(name):
    radiance, times = EXTREMES[name]
    raw = photograph(radiance, times, np.random.default_rng(1))
    found = merge_stack(Exposures(list(raw), times, [str(time) for time in times], SENSOR))
    np.testing.assert_array_equal(found.times.exposure_s, times)
    assert all(shift.status != ShiftStatus.SHIFTED for shift in found.alignment.shifts)
    whole = merge_exposures(raw, times, SENSOR)
    hot = found.radiance.status == PixelStatus.HOT  # what sticks out of white noise may look so
    assert hot.mean() < 1e-3
    np.testing.assert_array_equal(np.isnan(found.radiance.value), np.isnan(whole.value) | hot)
    assert max((rms for rms, _ in rms_by_tile(found.radiance, whole)), default=0.0) < 1.2 * SHARE


def test_wrong_times_and_movement_name_the_frames():
    rng = np.random.default_rng(0)
    raw = photograph(SCENE, EXPOSURE_S, rng)
    with pytest.raises(ImageError, match=r"wrong exposure times.* c states 0.5164 s and measures 0.25"):
        merged(raw, EXPOSURE_S * [1, 1, 2, 1, 1])
    np.testing.assert_allclose(
        merged(raw, EXPOSURE_S * [1, 1, 2, 1, 1], measured_times=True).times.exposure_s, EXPOSURE_S, rtol=5e-3
    )
    raw[3:] = photograph(np.roll(SCENE, 5, axis=1), EXPOSURE_S[3:], rng)
    with pytest.raises(ImageError, match=r"c and d: the picture moved by [45]\.\d px"):
        merged(raw, EXPOSURE_S)
    assert merged(raw, EXPOSURE_S, moved=True).alignment.worst.status == ShiftStatus.SHIFTED


def test_frames_of_the_simulated_rig_are_consistent_and_read_in_part(tmp_path):
    optics = Optics(1, "small", tmp_path)
    pose = Pose("brick", 0, 0.3, np.radians(70), 0.0, (("lamp4", 1.0),), np.radians(50), False, None)
    images = []
    for number, time_s in enumerate((0.002, 0.008, 0.03, 0.12, 0.5, 2.0)):
        path = tmp_path / f"{number}.dng"
        serial = optics.layout.cameras["cam3"].serial
        key = ("brick", number)
        path.write_bytes(optics.photograph("cam3", pose, time_s, serial=serial, frame_key=key, time_s=float(number)))
        images.append(map_raw(path))
    times = [image.exposure_s for image in images]
    # The small rig's 240 x 320 pixels nine times, else the survey alone would be all that there is.
    frames = [np.tile(image.mosaic, (3, 3)) for image in images]
    found = merge_stack(Exposures(frames, times, list("abcdef"), images[0].sensor))
    assert found.times.verdict in (TimesVerdict.CONSISTENT, TimesVerdict.CORRECTED)  # the sensor's curve is bent
    assert np.abs(np.log(found.times.scale)).max() < 0.01
    assert found.alignment.worst is None
    assert found.read.read_ratio < 0.95
    whole = merge_exposures(np.stack(frames), found.times.exposure_s, images[0].sensor)
    for rms, pixels in rms_by_tile(found.radiance, whole):
        assert rms < SHARE * (1 + 5 / np.sqrt(2 * pixels)) + 0.01
    saturated = whole.status == PixelStatus.SATURATED
    hot = found.radiance.status == PixelStatus.HOT
    np.testing.assert_array_equal((found.radiance.status == PixelStatus.SATURATED)[~hot], saturated[~hot])


def test_frames_that_are_no_stack_are_refused():
    raw = photograph(SCENE, EXPOSURE_S[:2], np.random.default_rng(0))
    for frames in ([raw[0], raw[1, :50]], [], [raw[0], raw[1].astype(np.float32)]):
        with pytest.raises(ImageError, match="needed"):
            merged(frames, EXPOSURE_S[:2])
