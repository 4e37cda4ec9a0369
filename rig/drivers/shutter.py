"""How a PTP camera is told its exposure time: counted in 0.1 ms, or as one of its own shutter speeds."""

from collections.abc import Callable
from dataclasses import dataclass
from math import log
from typing import Protocol

from rig.errors import LimitError
from rig.protocols import ptp
from rig.protocols.ptp import DeviceInfo, Property, PropertyDesc

_TICKS_PER_S = 10_000  # PTP counts exposure times in 0.1 ms
_AS_GOOD = 0.02  # relative: a speed this near to the exposure that was asked for is what was meant


class Shutter(Protocol):
    """Seconds to the value of a property and back; `rounding_s` is what its unit rounds off."""

    @property
    def code(self) -> Property:
        """Where the exposure time is set."""
        ...

    @property
    def rounding_s(self) -> float:
        """Half of the unit that times are counted in."""
        ...

    def value(self, camera: str, exposure_s: float) -> int:
        """What to set. Raises LimitError where the camera has no such exposure."""
        ...

    def seconds(self, value: int) -> float:
        """The exposure that a value stands for."""
        ...


@dataclass(frozen=True, slots=True)
class TickShutter:
    """The standard's exposure time, a whole number of ticks from `low` to `high`."""

    low: int = 1
    high: int = 2**32 - 1
    code = Property.EXPOSURE_TIME
    rounding_s = 0.5 / _TICKS_PER_S

    def value(self, camera: str, exposure_s: float) -> int:
        """The nearest tick."""
        if not self.low - 0.5 <= exposure_s * _TICKS_PER_S <= self.high + 0.5 or round(exposure_s * _TICKS_PER_S) < 1:
            raise LimitError(
                f"{camera}: an exposure of {exposure_s:g} s is outside {self.low / _TICKS_PER_S:g} to "
                f"{self.high / _TICKS_PER_S:g} s; nothing was exposed."
            )
        return round(exposure_s * _TICKS_PER_S)

    def seconds(self, value: int) -> float:
        """Ticks in seconds."""
        return value / _TICKS_PER_S


@dataclass(frozen=True, slots=True)
class SpeedShutter:
    """Shutter speeds as the camera lists them, as values of their property."""

    values: tuple[int, ...]
    code = Property.SHUTTER_SPEED
    rounding_s = 0.0

    def value(self, camera: str, exposure_s: float) -> int:
        """The nearest speed, where it is as good as what was asked for."""
        nearest = min(self.values, key=lambda value: abs(log(self.seconds(value) / exposure_s)))
        if abs(self.seconds(nearest) - exposure_s) > _AS_GOOD * exposure_s:
            raise LimitError(
                f"{camera}: no shutter speed of {exposure_s:g} s; the nearest of {len(self.values)} is "
                f"{self.seconds(nearest):g} s ({_written(nearest)}). Nothing was exposed."
            )
        return nearest

    def seconds(self, value: int) -> float:
        """A speed in seconds."""
        numerator, denominator = ptp.decode_speed(value)
        return numerator / denominator


def shutter_of(info: DeviceInfo, describe: Callable[[Property], PropertyDesc]) -> Shutter:
    """The finer way to tell a camera its exposure, where it has one."""
    if info.vendor_extension == ptp.MTP_EXTENSION and Property.SHUTTER_SPEED in info.properties:
        listed = describe(Property.SHUTTER_SPEED).values
        speeds = tuple(value for value in listed if all(ptp.decode_speed(value)))  # 0/0: the camera's own choice
        if speeds:
            return SpeedShutter(speeds)
    desc = describe(Property.EXPOSURE_TIME)
    if desc.range is not None:
        return TickShutter(*desc.range[:2])
    return TickShutter(min(desc.values), max(desc.values)) if desc.values else TickShutter()


def _written(value: int) -> str:
    return "/".join(map(str, ptp.decode_speed(value)))
