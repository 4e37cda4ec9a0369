"""One sweep of the simulated rig's laser over a relief with colour and texture, and its true displacements."""

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import map_coordinates

from processing.cameras.calibration import CameraModel
from processing.cameras.lens import Pinhole
from processing.laser.holder import Holder, plane_hits
from processing.laser.laser_plane import LaserMount
from processing.laser.mdf import Sweep
from processing.radiometry.sensor import Sensor
from simulators.optics import Optics
from simulators.pose import Pose

FRAMES, SHUTTER = 92, 0.5  # of the rig: 12.2 s at 7.5 Hz, open for 1/15 s
EXPOSURE_S = 1 / 15
ARC_RAD, ELEVATION_RAD = np.pi / 2, np.radians(50.0)  # from the side: the stripe stands upright in the picture
HOLDER = Holder(0.060, 0.076, 0.100, 0.008, 0.004, 0.003)


@dataclass(frozen=True)
class ReliefSweep:
    """What the camera recorded (t, h, w), as processing takes it, and the truth (h, w): NaN where no light falls."""

    sweep: Sweep
    displacement_m: np.ndarray

    @property
    def red(self):
        """The frames' red pixels (t, h / 2, w / 2), which see the stripe eight times brighter than the green ones."""
        return self.sweep.frames[:, ::2, ::2]

    def row_errors(self, columns, laser, wanted):
        """Displacement less the truth there, of a stripe found at these columns (t, h / 2) of the red pixels' rows.

        Where the nearest pixel is among the `wanted` (h, w).
        """
        frame, row = np.nonzero(np.isfinite(columns))
        uv_px = 2.0 * np.stack([columns[frame, row], row], axis=-1)
        column = np.clip(np.rint(uv_px[:, 0]).astype(int), 0, wanted.shape[1] - 1)
        inside = wanted[2 * row, column]
        uv_px, frame = uv_px[inside], frame[inside]
        camera = self.sweep.camera
        rays = camera.rays(uv_px)
        start = camera.centre_m - rays * (camera.centre_m[2] / rays[:, 2:])
        normal, offset = laser.planes(frame.astype(float))
        depth = (offset - np.einsum("ij,ij->i", normal, start)) / np.einsum("ij,ij->i", normal, rays)
        return depth - map_coordinates(self.displacement_m, uv_px[:, ::-1].T, order=1, cval=np.nan)


def photograph(seed, sample="brick", size="small", camera="cam4"):
    """The sweep of one rig; the camera is known exactly, the laser only as it is mounted."""
    with tempfile.TemporaryDirectory() as folder:
        optics = Optics(seed, size, Path(folder))
        poses = _poses(optics.layout.laser, sample)
        unit, still = optics.sensor(camera), optics.rate(camera, poses[0])
        frames, lit = [], np.zeros(still.shape, bool)
        for index, pose in enumerate(poses):
            stripe = optics.laser_rate(camera, pose)
            lit |= stripe > 0
            frames.append(unit.expose(still + stripe, EXPOSURE_S, (seed, sample, index)))
        points = np.load(optics.truth("points", poses[0], camera=camera)["path"])
        device = optics.layout.cameras[camera]
    lens = Pinhole(device.matrix, np.array([*device.distortion, 0, 0, 0]))
    model = CameraModel(lens, device.rig_from_camera, (device.height_px, device.width_px))
    mount = LaserMount(ARC_RAD, ELEVATION_RAD, optics.layout.laser.distance_m)
    sweep = Sweep(camera, np.stack(frames), Sensor(256.0, 4095.0, 4.0, 4.0), model, np.eye(4), mount)
    depth = np.einsum("hwi,hwi->hw", points - plane_hits(model, 0.0), model.pixel_rays())
    return ReliefSweep(sweep, np.where(lit, depth, np.nan))


def _poses(laser, sample):
    starts = np.linspace(0, laser.sweep_ticks, FRAMES, endpoint=False)
    shut = starts + SHUTTER * laser.sweep_ticks / FRAMES
    fans = [[laser.fan_rad(tick, ELEVATION_RAD) for tick in pair] for pair in zip(starts, shut, strict=True)]
    return [Pose(sample, 0, 0.0, ARC_RAD, 0.0, (), ELEVATION_RAD, True, (a, b)) for a, b in fans]
