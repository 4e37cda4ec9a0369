"""What is known of a rig beyond its nominal numbers: the results of the sessions that measured it."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from processing.cameras.calibration import CameraModel, read_cameras
from processing.errors import CalibrationError

CALIBRATION = "calibration"  # product folder of a `calibrate` session
CAMERAS = "cameras.json"


@dataclass(frozen=True)
class Calibrations:
    """Every part that was measured, by name; what was not is missing."""

    cameras: Mapping[str, CameraModel] = field(default_factory=dict)

    def camera(self, name: str) -> CameraModel:
        """The model of one camera. Raises CalibrationError that says how to get it."""
        if not self.cameras:
            raise CalibrationError(
                "this session needs calibrated cameras: name a calibrate session with --calibration."
            )
        if name not in self.cameras:
            raise CalibrationError(f"{name} is not calibrated; the calibration has: {', '.join(self.cameras)}.")
        return self.cameras[name]

    def digest(self) -> str:
        """Identity of a calibration: the digest of all of its numbers."""
        text = json.dumps({name: camera.to_json() for name, camera in self.cameras.items()}, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()


def load_calibrations(folders: Sequence[Path]) -> Calibrations:
    """What these processed sessions have measured; of a part that two have measured, the later named one's.

    Raises CalibrationError that names a session without such a result.
    """
    cameras: dict[str, CameraModel] = {}
    for folder in folders:
        path = folder / "products" / CALIBRATION / CAMERAS
        if not path.is_file():
            raise CalibrationError(f"{folder}: not calibrated yet; run `rig process {folder}` first.")
        cameras |= read_cameras(path)
    return Calibrations(cameras)
