import hashlib
import io
import json
from itertools import pairwise
from math import radians
from pathlib import Path

import numpy as np
import pytest
import rawpy

from simulators.lens import vignette
from simulators.light import CHANNELS, LASER_CHANNELS
from simulators.optics import Optics
from simulators.truth import Truth
from tests.reference.sensor import electrons

LAMP = (("lamp4", 0.7),)


def _raw(data: bytes) -> np.ndarray:
    with rawpy.imread(io.BytesIO(data)) as raw:
        return raw.raw_image.copy()


def _sweep(optics: Optics, first: float, last: float) -> tuple[float, float]:
    return tuple(optics.layout.laser.fan_rad(ticks, radians(50)) for ticks in (first, last))


def _swept(optics, pose, first, last, **changes):
    return pose(laser_on=True, laser_sweep=_sweep(optics, first, last), light_arc_rad=radians(45), **changes)


def test_mean_of_many_frames_is_the_noise_free_mosaic(optics, pose):
    lit = pose(sample="brick", lamps=LAMP)
    count, exposure_s = 60, 0.1
    frames = [
        _raw(optics.photograph("cam3", lit, exposure_s, serial="a", frame_key=(i,), time_s=0)) for i in range(count)
    ]
    unit = optics.sensor("cam3")
    expected = optics.rate("cam3", lit) * exposure_s
    dark_variance = unit.sensor.read_noise_e**2 + unit.sensor.gain_e_per_dn**2 / 12
    sigma = np.sqrt((expected + dark_variance) / count)
    pull = ((electrons(np.mean(frames, axis=0), unit) - expected) / sigma)[expected < 14500]
    assert abs(pull.mean()) < 5 / np.sqrt(pull.size) + 0.01
    assert pull.std() == pytest.approx(1, abs=0.02)


def test_the_white_frame_gives_what_a_lambertian_plane_must(optics, pose):
    """60 000 e-/s facing the lamp at its nominal distance, times its gains, cosine, response and vignetting."""
    lit = pose(lamps=(("lamp4", 1.0),))
    rate = (optics.rate("cam7", lit) - optics.rate("cam7", pose())) / optics.sensor("cam7").response
    camera = optics.layout.cameras["cam7"]
    column, row = (round(float(x)) for x in camera.matrix[:2, 2])
    patch = rate[row - 2 : row + 2, column - 2 : column + 2]
    rows, columns = np.indices(patch.shape) + np.array([[[row - 2]], [[column - 2]]])
    lamp = optics.layout.lamps["lamp4"]
    place = optics.layout.lamp_position("lamp4", radians(90), 0.0)
    facing = place[2] * lamp.distance_m**2 / np.linalg.norm(place) ** 3
    expected = 60000 * facing * (CHANNELS * lamp.gains)[rows % 2 + columns % 2]
    # the patch is within 5 mm of the origin: 5 mm of 900 mm, squared, is about 1 %
    np.testing.assert_allclose(patch, expected, rtol=0.012)


def test_lamps_add_up_and_scale_with_their_level(optics, pose):
    base = optics.rate("cam5", pose(sample="brick"))
    one, two = (optics.rate("cam5", pose(sample="brick", lamps=((name, 1.0),))) - base for name in ("lamp1", "lamp5"))
    both = optics.rate("cam5", pose(sample="brick", lamps=(("lamp1", 0.5), ("lamp5", 0.25)))) - base
    np.testing.assert_allclose(both, 0.5 * one + 0.25 * two, rtol=1e-3, atol=0.05)


def test_same_seed_same_bits_whatever_came_before(optics, pose, tmp_path):
    """Another process with other history, here another instance, makes the same file."""
    lit, swept = pose(sample="brick", lamps=LAMP), _swept(optics, pose, 200, 201, sample="brick")
    wanted = [(lit, ("x", 1)), (swept, ("x", 2)), (lit, ("x", 3))]

    def digests(rig: Optics, order: list[int]) -> dict[int, str]:
        files = {}
        for k in order:
            data = rig.photograph("cam2", wanted[k][0], 0.05, serial="b", frame_key=wanted[k][1], time_s=1.0)
            files[k] = hashlib.sha256(data).hexdigest()
        return files

    first = digests(optics, [0, 1, 2])
    assert digests(Optics(1, "small", tmp_path), [2, 1, 0]) == first
    assert first[0] != first[2]


def test_another_seed_is_another_rig_and_another_noise(optics, pose, tmp_path):
    lit = pose(lamps=LAMP)
    other = Optics(2, "small", tmp_path)
    first, second = (
        _raw(rig.photograph("cam2", lit, 0.05, serial="b", frame_key=(1,), time_s=0)) for rig in (optics, other)
    )
    assert np.any(first != second)


@pytest.mark.parametrize("sample", ["brick", "white"])
def test_the_stripe_lies_in_its_plane(optics, pose, sample):
    """Every bright pixel's first hit is within 5 sigma of the plane (4.6 sigma leave 2.5e-5 of the peak)."""
    swept = _swept(optics, pose, 240, 240.001, sample=sample)
    rate = optics.laser_rate("cam4", swept)
    points = np.load(optics.truth("points", swept, camera="cam4")["path"])
    normal, offset = optics.layout.laser.plane(swept.light_arc_rad, swept.laser_elevation_rad, swept.laser_sweep[0])
    away = np.abs(points @ normal - offset)
    bright = rate > 2.5e-5 * rate.max()
    assert bright.sum() > 300
    assert away[bright].max() < 5 * optics.layout.laser.sigma_m


def test_the_stripe_fades_with_the_distance_not_its_square(optics, pose):
    """Light crosses every arc about the source in a stripe of the same width: irradiance goes as 1 / distance."""
    camera, laser, brightness = optics.layout.cameras["cam7"], optics.layout.laser, []
    rows, columns = np.indices((camera.height_px, camera.width_px))
    response = LASER_CHANNELS[rows % 2 + columns % 2] * vignette(camera) * optics.sensor("cam7").response
    for ticks in (60, 420):  # 39 mm behind the axis and before it: 66 mm nearer to the laser
        swept = _swept(optics, pose, ticks, ticks)
        points = np.load(optics.truth("points", swept, camera="cam7")["path"])
        source = laser.source(swept.light_arc_rad, swept.laser_elevation_rad)
        normal, offset = laser.plane(swept.light_arc_rad, swept.laser_elevation_rad, swept.laser_sweep[0])
        middle = (np.abs(points @ normal - offset) < 0.3 * laser.sigma_m) & (np.abs(points[..., 2]) < 1e-4)
        distance = np.linalg.norm(points - source, axis=-1)
        facing = source[2] / distance * response / distance
        brightness.append(np.mean((optics.laser_rate("cam7", swept) / facing)[middle]))
    # speckle of 3 % over some 50 pixels and more; the square of the distance would tell them apart by 7 %
    assert brightness[0] == pytest.approx(brightness[1], rel=0.02)


def test_a_sweep_lights_every_visible_pixel_once(optics, pose):
    """The frames of a sweep, weighted by their way, add up to the same pulse as one long exposure."""
    edges = np.linspace(200, 280, 9)
    whole = optics.laser_rate("cam4", _swept(optics, pose, 200, 280, sample="brick"))
    parts = [optics.laser_rate("cam4", _swept(optics, pose, a, b, sample="brick")) for a, b in pairwise(edges)]
    np.testing.assert_allclose(np.mean(parts, axis=0), whole, rtol=2e-3, atol=whole.max() * 1e-5)


def test_a_laser_frame_peaks_below_saturation_on_white(optics, pose):
    swept = _swept(optics, pose, 240, 242.6)
    peak_e = np.percentile(optics.laser_rate("cam4", swept), 99.9) / 15
    assert 6000 < peak_e < 15356


def test_nothing_shines_in_the_dark(optics, pose):
    dark = optics.rate("cam4", pose(sample="brick"))
    assert np.median(dark) < 30
    assert not optics.laser_rate("cam4", pose(laser_on=True)).any()


def test_the_turntable_turns_the_sample_under_the_camera(optics, pose):
    """By half a turn the picture of the centred, evenly lit holder looks the same, the brick does not."""
    lamps = (("lamp7", 1.0),)
    white = [optics.rate("cam7", pose(lamps=lamps, turntable_rad=a)) for a in (0.0, np.pi)]
    brick = [optics.rate("cam7", pose(sample="brick", lamps=lamps, turntable_rad=a)) for a in (0.0, np.pi)]
    middle = np.s_[80:160, 120:200]
    np.testing.assert_allclose(white[0][middle], white[1][middle], rtol=1e-3)
    assert np.mean(np.abs(brick[0] - brick[1])[middle]) > 0.1 * np.mean(brick[0][middle])


def test_every_exposure_leaves_a_line_of_truth(pose, tmp_path):
    rig = Optics(1, "small", tmp_path)
    lit = pose(lamps=LAMP)
    for key, seen in enumerate((lit, lit, _swept(rig, pose, 240, 241))):
        rig.photograph("cam6", seen, 0.1, serial="VC-0006", frame_key=(key,), time_s=3.5)
    lines = [json.loads(line) for line in (tmp_path / "frames.jsonl").read_text().splitlines()]
    assert len({line["id"] for line in lines}) == 3
    assert lines[0]["radiance"] == lines[1]["radiance"]
    np.testing.assert_array_equal(np.load(tmp_path / lines[0]["radiance"]), rig.rate("cam6", lit))
    assert lines[2]["radiance"] is None
    assert len(lines[2]["laser"]["planes"]) == 2
    assert len(list(Path(tmp_path / "radiance").iterdir())) == 1


@pytest.mark.parametrize("lamps", [(), (("lamp4", 1.0),)])
def test_a_cap_leaves_the_dark_current_and_a_light_box_an_even_field(optics, pose, lamps):
    """Whatever shines in the room; the light box is as bright as white that faces a lamp."""
    unit = optics.sensor("cam6")
    capped = optics.rate("cam6", pose(sample="cap", lamps=lamps))
    np.testing.assert_array_equal(capped, unit.dark_e_s)
    field = optics.rate("cam6", pose(sample="lightbox", lamps=lamps)) - capped
    rows, columns = np.indices(field.shape)
    even = field / CHANNELS[rows % 2 + columns % 2] / vignette(optics.layout.cameras["cam6"]) / unit.response
    normal = capped < 100  # beside the hot pixels, whose dark current leaves float32 fewer digits
    np.testing.assert_allclose(even[normal], 60000, rtol=1e-5)
    for sample in ("cap", "lightbox"):
        assert not optics.laser_rate("cam6", _swept(optics, pose, 240, 241, sample=sample)).any()


def test_unknown_sample_and_truth_are_refused(optics, pose, studio, tmp_path):
    with pytest.raises(ValueError, match="cheese"):
        optics.rate("cam1", pose(sample="cheese"))
    with pytest.raises(ValueError, match="displacement"):
        optics.truth("everything", pose())
    with pytest.raises(ValueError, match="texels"):
        optics.truth("displacement", pose(), camera="cam1")
    with pytest.raises(ValueError, match="cam9"):
        Truth(tmp_path, studio, optics.rate, optics.phone).points(pose(), "cam9")


def test_the_full_rig_makes_full_pictures(pose, tmp_path):
    rig = Optics(1, "full", tmp_path)
    data = rig.photograph("cam7", pose(lamps=LAMP), 0.1, serial="VC-0007", frame_key=(), time_s=0.0)
    assert _raw(data).shape == (768, 1024)
