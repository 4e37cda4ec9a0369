"""What was measured of one camera's sensor, as a product folder: kept with the serial number, used on its frames."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.errors import CalibrationError, ImageError
from processing.products.provenance import Provenance, read_arrays, read_description, write_description
from processing.radiometry.linearity import Linearity
from processing.radiometry.photon_transfer import Measured, SensorMeasurement, Transfer
from processing.radiometry.sensor import PixelCorrection, Sensor

KIND = "sensor"
MAPS = "maps.npz"
CODES = 1 << 16


@dataclass(frozen=True, eq=False)
class SensorCalibration:
    """One camera's sensor at one ISO: model, maps of its pixels, linearity, each figure with its standard deviation.

    `stated` are the levels that the camera's files carry, by which frames of another setting are told. `date_utc` is
    when the frames were taken.
    """

    serial: str
    model: str
    iso: float
    stated: Sensor
    measurement: SensorMeasurement
    date_utc: str = ""
    provenance: Provenance = field(default_factory=Provenance)

    @property
    def sensor(self) -> Sensor:
        """The noise model of linear counts without the pixels' offsets: read noise, and what is left of those."""
        sensor, left_dn = self.measurement.sensor, self.measurement.figures["offset_left_dn"].value
        noise_e = float(np.hypot(sensor.read_noise_e, sensor.gain_e_per_dn * left_dn))
        return replace(sensor, read_noise_e=noise_e)

    @property
    def counted_sensor(self) -> Sensor:
        """The noise model of counts as they are read, for what does not go through `linear_dn`."""
        sensor, saturation = self.measurement.sensor, self.measurement.figures["saturation_dn"].value
        return Sensor(sensor.black_dn, saturation, sensor.gain_e_per_dn, sensor.read_noise_e)

    @property
    def correction(self) -> PixelCorrection:
        """The maps of its pixels."""
        return self.measurement.correction

    def linear_dn(self, raw_dn: NDArray[np.uint16]) -> NDArray[np.uint16] | NDArray[np.float32]:
        """Counts (..., h, w) that grow evenly with the light, as `sensor` counts them; the very same where they do.

        What is saturated comes out at the white level or above.
        """
        linearity, black = self.measurement.linearity, self.sensor.black_dn
        if not linearity.significant:
            return raw_dn
        codes = np.arange(CODES)
        table = (black + linearity.linear_dn(codes - black)).astype(np.float32)
        saturated = codes >= self.measurement.figures["saturation_dn"].value
        table[saturated] = np.float32(self.sensor.white_dn)
        return table[raw_dn]

    def takes(self, serial: str, iso: float) -> bool:
        """Whether frames of this camera and ISO are those that it measured; an unknown ISO equals another."""
        return self.serial == serial and str(float(self.iso)) == str(float(iso))

    def check_takes(self, serial: str, iso: float) -> None:
        """Raises CalibrationError where frames are another camera's, or at another ISO."""
        if not self.takes(serial, iso):
            camera = serial or "a camera without a serial number"
            raise CalibrationError(
                f"the sensor that was measured is {self.serial} at ISO {self.iso:g}, the frames are of {camera} "
                f"at ISO {iso:g}. Name the folder of the camera that took them."
            )

    def check_fits(self, shape: tuple[int, ...], stated: Sensor) -> None:
        """Raises CalibrationError where frames (h, w) or the levels stated in them are not those that were measured."""
        maps = self.correction.flat.shape
        again = "Measure the sensor as it is used, or leave this calibration out."
        if tuple(shape) != maps:
            raise CalibrationError(
                f"sensor {self.serial}: its maps have {maps[1]} x {maps[0]} pixels, "
                f"the frames {shape[1]} x {shape[0]}. {again}"
            )
        if (stated.black_dn, stated.white_dn) != (self.stated.black_dn, self.stated.white_dn):
            raise CalibrationError(
                f"sensor {self.serial}: measured with levels {self.stated.black_dn:g} to {self.stated.white_dn:g} dn, "
                f"the frames state {stated.black_dn:g} to {stated.white_dn:g}. {again}"
            )

    def digest(self) -> str:
        """Identity of the numbers."""
        measured = self.measurement
        text = json.dumps([self.serial, self.iso, asdict(measured.sensor), asdict(measured.linearity)])
        digest = hashlib.sha256(text.encode())
        for values in _maps(measured.correction).values():
            digest.update(np.ascontiguousarray(values).tobytes())
        return digest.hexdigest()

    def save(self, folder: Path) -> None:
        """Write maps.npz (maps, and the levels of the photon transfer) and product.json into `folder`."""
        folder.mkdir(parents=True, exist_ok=True)
        measured = self.measurement
        arrays: dict[str, Any] = {f"transfer_{name}": values for name, values in vars(measured.transfer).items()}
        np.savez_compressed(folder / MAPS, **arrays | _maps(measured.correction))
        content = {
            "file": MAPS,
            "serial": self.serial,
            "model": self.model,
            "iso": self.iso if np.isfinite(self.iso) else None,
            "date_utc": self.date_utc,
            "sensor": asdict(measured.sensor),
            "stated": asdict(self.stated),
            "linearity": asdict(measured.linearity),
            "figures": {name: _json(figure) for name, figure in measured.figures.items()},
        }
        write_description(folder, KIND, content, self.provenance)

    @classmethod
    def load(cls, folder: Path) -> "SensorCalibration":
        """Read what `save` wrote; raises ImageError where the folder holds something else."""
        content, provenance = read_description(folder, KIND)
        try:
            sensor, stated = Sensor(**content["sensor"]), Sensor(**content["stated"])
            linearity = Linearity(**content["linearity"])
            figures = {name: _measured(pair) for name, pair in content["figures"].items()}
            about = (content["serial"], content["model"], float("nan") if content["iso"] is None else content["iso"])
            date_utc, file = content["date_utc"], content["file"]
        except (KeyError, TypeError, ValueError) as error:
            raise ImageError(
                f"{folder}: not a whole sensor calibration ({error}); process the session again"
            ) from error
        names = [*(one.name for one in fields(PixelCorrection)), *(f"transfer_{one.name}" for one in fields(Transfer))]
        arrays = dict(zip(names, read_arrays(folder / file, names), strict=True))
        transfer = Transfer(**{one.name: arrays.pop(f"transfer_{one.name}") for one in fields(Transfer)})
        measured = SensorMeasurement(sensor, PixelCorrection(**arrays), linearity, figures, transfer)
        return cls(*about, stated, measured, date_utc, provenance)


def _maps(correction: PixelCorrection) -> dict[str, NDArray[np.generic]]:
    return {one.name: getattr(correction, one.name) for one in fields(PixelCorrection)}


def _json(figure: Measured) -> dict[str, float | None]:
    """JSON has no NaN; an unknown standard deviation is null."""
    return {"value": figure.value, "sigma": figure.sigma if np.isfinite(figure.sigma) else None}


def _measured(pair: Mapping[str, Any]) -> Measured:
    return Measured(float(pair["value"]), float("nan") if pair["sigma"] is None else float(pair["sigma"]))
