"""Merging, rectification and reflectance on frames of the simulated rig, against its noise-free truth."""

from dataclasses import replace

import numpy as np
import pytest

from processing.cameras.calibration import CameraModel
from processing.cameras.lens import Pinhole
from processing.cameras.rectification import Texels, rectify
from processing.cameras.white_frame import WhiteFrame, reflectance, white_frame_radiance
from processing.formats.raw import read_raw
from processing.geometry import rotation_z
from processing.radiometry.hdr import PixelStatus, merge_exposures
from simulators.optics import Optics
from simulators.pose import Pose
from tests.reference.sensor import linear_dn

EXPOSURES_S = (0.02, 0.2, 1.0)
TURN_RAD = np.pi / 2
WHITE = Pose("white", 0, TURN_RAD, np.radians(70), 0.0, (("lamp4", 1.0),), np.radians(50), False, None)


@pytest.fixture(scope="module")
def bracket(tmp_path_factory):
    """Optics, layout of a camera at 50 deg, and its bracket of a white plate, merged with its sensor's true numbers."""
    optics = Optics(1, "small", tmp_path_factory.mktemp("truth"))
    device = optics.layout.cameras["cam3"]
    frames = [
        read_raw(optics.photograph("cam3", WHITE, t, serial=device.serial, frame_key=("white", i), time_s=float(i)))
        for i, t in enumerate(EXPOSURES_S)
    ]
    unit, nominal = optics.sensor("cam3"), frames[0].sensor
    counts = [np.where(f.mosaic < 4095, linear_dn(f.mosaic, unit) + 256, np.inf) for f in frames]
    true = replace(nominal, gain_e_per_dn=unit.sensor.gain_e_per_dn, read_noise_e=unit.sensor.read_noise_e)
    merged = merge_exposures(np.stack(counts), [f.exposure_s for f in frames], true)
    return optics, device, merged, frames[0].cfa


def test_merged_frames_are_the_truth_within_their_own_variance(bracket):
    optics, _, merged, _ = bracket
    error = (merged.value - optics.rate("cam3", WHITE)) / np.sqrt(merged.variance)
    lit = (merged.status == PixelStatus.OK) & np.isfinite(error)
    # Robust, since a sensor has a few hot pixels and its pixels differ by a little more than shot noise.
    assert abs(np.median(error[lit])) < 0.05
    assert 0.9 < 1.4826 * np.median(np.abs(error[lit])) < 1.15


def test_a_white_plate_has_its_albedo(bracket):
    _, device, merged, cfa = bracket
    camera = CameraModel(
        Pinhole(device.matrix, np.array([*device.distortion, 0, 0, 0])),
        device.rig_from_camera,
        (device.height_px, device.width_px),
    )
    turn = rotation_z(TURN_RAD)
    white = white_frame_radiance(merged, camera, turn, WhiteFrame(0.060, 0.076), cfa)
    plate = reflectance(rectify(merged, camera, turn, Texels(32, 0.060), cfa), white, 0.9)
    assert plate.valid.all()
    # Stray light between frame and plate, and the quadratic, are under half a percent together.
    np.testing.assert_allclose(np.pi * plate.value.mean(axis=(0, 1)), 0.9, rtol=5e-3)
    ratio = plate.value.std(axis=(0, 1)) / np.sqrt(plate.variance.mean(axis=(0, 1)))
    assert ((ratio > 0.8) & (ratio < 1.3)).all()
