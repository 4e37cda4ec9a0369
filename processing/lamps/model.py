"""What is known of a lamp: place in the frame of the axis that carries it, intensity, falloff, and how well."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from math import radians
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing import geometry
from processing.errors import CalibrationError

Array = NDArray[np.float64]
INVERSE_SQUARE = 2.0
# What is believed of a lamp before its light is seen, one sigma.
DISTANCE_SIGMA = 0.02  # of its nominal distance, relative: a tape's, to a housing
DIRECTION_SIGMA_RAD = radians(5.0)  # of its nominal direction
_SCHEMA = "lamp-models/1"


class LampStatus(IntEnum):
    """What of a lamp is measured."""

    MEASURED = 0
    DISTANCE_ASSUMED = 1  # its direction is measured, its distance is little better known than before
    NOT_MEASURED = 2  # no light of it was found: the place is the nominal one


@dataclass(frozen=True, slots=True)
class NominalLamp:
    """What a lamp's label says: its carrier, and its position (3,) while that stands at 0."""

    mount: str
    position_m: Array


@dataclass(frozen=True, eq=False)
class LampPlaces:
    """What is known of lamps together: `positions_m` (n, 3) in their carriers' frames, `covariance_m2` (3 n, 3 n)."""

    names: tuple[str, ...]
    positions_m: Array
    covariance_m2: Array

    def covariance(self, name: str) -> Array:
        """Covariance (3, 3) of one lamp's position."""
        at = 3 * self.names.index(name)
        return self.covariance_m2[at : at + 3, at : at + 3]


def nominal_position(elevation_rad: float, distance_m: float) -> Array:
    """Position (3,) of a lamp whose carrier stands at azimuth 0."""
    return distance_m * np.array([np.cos(elevation_rad), 0.0, np.sin(elevation_rad)])


def nominal_places(nominal: Mapping[str, NominalLamp]) -> LampPlaces:
    """What is believed of lamps before any light of theirs is seen."""
    names = tuple(sorted(nominal))
    positions = np.stack([nominal[name].position_m for name in names])
    covariance = np.zeros((3 * len(names), 3 * len(names)))
    for number, position in enumerate(positions):
        square = float(position @ position)
        outward = np.outer(position, position) / square
        spread = square * (DISTANCE_SIGMA**2 * outward + DIRECTION_SIGMA_RAD**2 * (np.eye(3) - outward))
        covariance[3 * number : 3 * number + 3, 3 * number : 3 * number + 3] = spread
    return LampPlaces(names, positions, covariance)


def _unknown() -> Array:
    return np.full(3, np.nan)


@dataclass(frozen=True)
class LampModel:
    """One lamp, a point source.

    `position_m` (3,) and its `covariance_m2` (3, 3) are in the frame of the carrier: the rig frame while the axis
    `mount` stands at 0. The axis turns about the rig's Z, so at an angle a the lamp is at R_z(a) position; an error of
    the axis's own zero is part of the position. `intensity_e_s` (3,) is what a pixel counts per second of a perfect
    white diffuser that faces the lamp at 1 m, per channel, with its `intensity_deviation`; irradiance falls off as
    distance to the power of -`falloff`, 2 where its deviation admits it. NaN = not measured.
    """

    name: str
    mount: str
    position_m: Array
    covariance_m2: Array
    status: LampStatus = LampStatus.MEASURED
    intensity_e_s: Array = field(default_factory=_unknown)
    intensity_deviation: Array = field(default_factory=_unknown)
    falloff: float = INVERSE_SQUARE
    falloff_deviation: float = float("nan")

    @property
    def distance_m(self) -> float:
        """Distance from the rig's origin."""
        return float(np.linalg.norm(self.position_m))

    @property
    def distance_deviation_m(self) -> float:
        """One sigma of `distance_m`."""
        outward = self.position_m / self.distance_m
        return float(np.sqrt(outward @ self.covariance_m2 @ outward))

    @property
    def direction_deviation_rad(self) -> float:
        """One sigma of the direction: root of the mean square angle to the true one."""
        return float(np.sqrt(max(np.trace(self.covariance_m2) - self.distance_deviation_m**2, 0.0))) / self.distance_m

    def position(self, angle_rad: float) -> Array:
        """Position (3,) in the rig frame, metres, while the carrier stands at this angle."""
        return geometry.rotate(geometry.rotation_z(angle_rad), self.position_m)

    def direction(self, angle_rad: float) -> Array:
        """Unit vector (3,) from the rig's origin to the lamp, rig frame, while the carrier stands at this angle."""
        return self.position(angle_rad) / self.distance_m

    def to_json(self) -> dict[str, Any]:
        """Numbers, lists and None for what is not known."""
        return {
            "name": self.name,
            "mount": self.mount,
            "status": self.status.name,
            "position_m": self.position_m.tolist(),
            "covariance_m2": self.covariance_m2.tolist(),
            "intensity_e_s": [_number(value) for value in self.intensity_e_s],
            "intensity_deviation": [_number(value) for value in self.intensity_deviation],
            "falloff": self.falloff,
            "falloff_deviation": _number(self.falloff_deviation),
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> "LampModel":
        """Inverse of `to_json`. Raises CalibrationError where a field is missing or misshapen."""
        try:
            return cls(
                str(data["name"]),
                str(data["mount"]),
                np.asarray(data["position_m"], np.float64).reshape(3),
                np.asarray(data["covariance_m2"], np.float64).reshape(3, 3),
                LampStatus[data["status"]],
                np.array(data["intensity_e_s"], np.float64).reshape(3),
                np.array(data["intensity_deviation"], np.float64).reshape(3),
                float(data["falloff"]),
                float(np.float64(data["falloff_deviation"])),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise CalibrationError(f"not a lamp model: {error!r}") from error


def write_lamps(lamps: Mapping[str, LampModel], path: Path) -> None:
    """Write lamp models as JSON."""
    content = {"schema": _SCHEMA, "lamps": {name: lamp.to_json() for name, lamp in lamps.items()}}
    path.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def read_lamps(path: Path) -> dict[str, LampModel]:
    """Read lamp models. Raises CalibrationError that names the file."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["schema"] != _SCHEMA:
            raise CalibrationError(f"schema {content['schema']!r}, not {_SCHEMA!r}")
        return {name: LampModel.from_json(data) for name, data in content["lamps"].items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError, CalibrationError) as error:
        raise CalibrationError(f"{path}: not a calibration of lamps: {error}. Run the lamps plan again.") from error


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
