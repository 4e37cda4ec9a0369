"""What is known of a rig beyond its nominal numbers: the results of the sessions that measured it."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from processing.cameras.calibration import CameraModel, read_cameras
from processing.errors import CalibrationError
from processing.lamps.model import LampModel, LampStatus, read_lamps
from processing.radiometry.sensor import Sensor
from processing.radiometry.sensor_calibration import SensorCalibration

CALIBRATION = "calibration"  # product folder of a `calibrate` session
CAMERAS = "cameras.json"
SENSORS = "sensors"  # folder of a `sensor` session's products, one for each serial number
LAMPS = "lamps"  # product folder of a `lamps` session
LAMP_MODELS = "lamps.json"


@dataclass(frozen=True)
class Calibrations:
    """Every part that was measured, by name; what was not is missing."""

    cameras: Mapping[str, CameraModel] = field(default_factory=dict)
    sensors: Mapping[str, SensorCalibration] = field(default_factory=dict)  # by serial number
    lamps: Mapping[str, LampModel] = field(default_factory=dict)

    def camera(self, name: str) -> CameraModel:
        """The model of one camera. Raises CalibrationError that says how to get it."""
        if not self.cameras:
            raise CalibrationError(
                "this session needs calibrated cameras: name a calibrate session with --calibration."
            )
        if name not in self.cameras:
            raise CalibrationError(f"{name} is not calibrated; the calibration has: {', '.join(self.cameras)}.")
        return self.cameras[name]

    def lamp(self, name: str) -> LampModel | None:
        """The model of one lamp, None where it was not measured and its nominal place is all that is known."""
        model = self.lamps.get(name)
        return None if model is None or model.status == LampStatus.NOT_MEASURED else model

    def sensor(
        self, serial: str, stated: Sensor, shape: tuple[int, ...], iso: float | None = None
    ) -> SensorCalibration | None:
        """The measured sensor that took frames (h, w) at this ISO, any where it is not known; None where there is none.

        Raises CalibrationError where it was measured at another size or with other levels than the files state.
        """
        found = self.sensors.get(serial)
        if found is None or not (iso is None or found.takes(serial, iso)):
            return None
        found.check_fits(shape, stated)
        return found

    def digest(self) -> str:
        """Identity of a calibration: the digest of all of its numbers."""
        numbers = {
            "cameras": {name: camera.to_json() for name, camera in self.cameras.items()},
            "sensors": {serial: sensor.digest() for serial, sensor in self.sensors.items()},
            "lamps": {name: lamp.to_json() for name, lamp in self.lamps.items()},
        }
        text = json.dumps(numbers, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()


def load_calibrations(folders: Sequence[Path]) -> Calibrations:
    """What these processed sessions have measured; of a part that two have measured, the later named one's.

    Raises CalibrationError that names a session without such a result.
    """
    cameras: dict[str, CameraModel] = {}
    sensors: dict[str, SensorCalibration] = {}
    lamps: dict[str, LampModel] = {}
    for folder in folders:
        of_cameras = folder / "products" / CALIBRATION / CAMERAS
        of_lamps = folder / "products" / LAMPS / LAMP_MODELS
        measured = sorted((folder / "products" / SENSORS).glob("*/product.json"))
        if not of_cameras.is_file() and not of_lamps.is_file() and not measured:
            raise CalibrationError(f"{folder}: not calibrated yet; run `rig process {folder}` first.")
        cameras |= read_cameras(of_cameras) if of_cameras.is_file() else {}
        lamps |= read_lamps(of_lamps) if of_lamps.is_file() else {}
        found = [SensorCalibration.load(product.parent) for product in measured]
        sensors |= {sensor.serial: sensor for sensor in found}
    return Calibrations(cameras, sensors, lamps)
