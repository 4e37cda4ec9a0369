"""What the cameras photograph."""

import hashlib
from pathlib import Path

import numpy as np

from simulators.dng import RawFile, encode_dng
from simulators.layout import build_layout
from simulators.pose import Pose
from simulators.sensor import Sensor


class Optics:
    """Light, scenes and cameras of one rig."""

    def __init__(self, seed: int, size: str, truth_dir: Path) -> None:
        self.layout = build_layout(seed, size)
        self._seed = seed
        self._truth_dir = truth_dir
        self._sensor = Sensor()

    def photograph(
        self,
        camera: str,
        pose: Pose,
        exposure_s: float,
        *,
        serial: str,
        frame_key: tuple[int | str, ...],
        time_s: float,
    ) -> bytes:
        """The DNG file of one exposure."""
        device = self.layout.cameras[camera]
        level = 60000.0 * sum(level for _, level in pose.lamps)
        rate = np.full((device.height_px, device.width_px), level, np.float32)
        key = (self._seed, serial, *frame_key)
        counts = self._sensor.expose(rate, exposure_s, key)
        unique_id = hashlib.blake2b(repr(key).encode(), digest_size=16).hexdigest()
        raw = RawFile(
            serial, device.model, self._sensor.black_dn, self._sensor.white_dn, self._sensor.noise_profile(), np.eye(3),
            (0.6, 1.0, 0.72), exposure_s, 100, 8.0, 50.0, time_s, unique_id,
        )  # fmt: skip
        return encode_dng(counts, raw)
