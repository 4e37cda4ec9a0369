"""The devices as the session engine sees them: SI units, no bytes.

Drivers implement these protocols, the runner uses them. Commands that take time start and return; `wait` and
`fetch` end them, so that motion, exposure and transfer of different devices overlap.
"""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import nan
from types import TracebackType
from typing import Protocol, Self

from rig.errors import ReadTimeoutError, TransportError
from rig.interrupts import postponed

log = logging.getLogger(__name__)


class Clock(Protocol):
    """The rig's time: monotonic on hardware, the simulators' shared clock in a simulated rig."""

    def now_s(self) -> float:
        """Seconds since some fixed moment; never goes back."""
        ...

    def sleep(self, seconds: float) -> None:
        """Let that much of the rig's time pass."""
        ...


class Axis(Protocol):
    """A stepper axis: LED arm, light arc or turntable."""

    @property
    def name(self) -> str:
        """Key in rig.toml, [axes.NAME]."""
        ...

    def home(self) -> None:
        """Search the reference switch and wait for it; afterwards the angle can be trusted."""
        ...

    def check(self, angle_rad: float) -> None:
        """Raises LimitError or InterlockError where `move_to` would; moves nothing."""
        ...

    def move_to(self, angle_rad: float) -> None:
        """Start the move and return. Raises LimitError before anything moves, StateError if not homed."""
        ...

    def wait(self) -> None:
        """Return once the axis stands at its target and has settled. Raises DeviceError on a stall."""
        ...

    def angle_rad(self) -> float:
        """The angle that the axis reports."""
        ...

    def stop(self) -> None:
        """Stop at once."""
        ...

    def move_time_s(self, from_rad: float, to_rad: float) -> float:
        """Time of the move by its ramps, settling included."""
        ...


class Lamps(Protocol):
    """All lamps behind one DMX widget."""

    @property
    def names(self) -> tuple[str, ...]:
        """Lamp names in channel order."""
        ...

    def light(self, levels: Mapping[str, float]) -> None:
        """Set these lamps to their levels in [0, 1] and every other lamp to 0."""
        ...

    def off(self) -> None:
        """All lamps to 0."""
        ...


class FileFormat(StrEnum):
    """What kind of file a camera is to deliver; its value is also the file's ending where the format has only one."""

    RAW = "dng"
    JPEG = "jpg"


@dataclass(frozen=True, slots=True)
class RawFrame:
    """One frame as the camera delivered it.

    `data` is the camera's own file; `serial`, `exposure_s`, `iso` (NaN where it is not told) and `file_format` are read
    from it, not from what was asked.
    `index` counts within a burst. `taken_s` is the rig clock's time at which the exposure was asked to begin; later
    frames of a burst are as far behind as the camera's own clock says to the millisecond, else index times interval.
    """

    camera: str
    serial: str
    data: bytes
    exposure_s: float
    index: int
    taken_s: float
    iso: float = nan
    file_format: FileFormat = FileFormat.RAW


class Camera(Protocol):
    """A camera that delivers files of its own."""

    @property
    def name(self) -> str:
        """Key in rig.toml, [cameras.NAME]."""
        ...

    def expose(
        self,
        exposure_s: float,
        *,
        frames: int = 1,
        interval_s: float = 0.0,
        file_format: FileFormat = FileFormat.RAW,
    ) -> None:
        """Start one exposure, or a burst with that interval between starts, and return."""
        ...

    def fetch(self) -> Sequence[RawFrame]:
        """Wait for the exposures started last and download their frames, in order.

        Raises ReadTimeoutError where a frame does not come, FrameCheckError where its serial number or exposure is
        not the one asked for.
        """
        ...

    def abort(self) -> None:
        """Drop what is under way."""
        ...

    def transfer_time_s(self, frames: int) -> float:
        """Forecast of the download."""
        ...


class LaserUnit(Protocol):
    """A line laser on a geared motor whose stripe sweeps over the sample."""

    def rewind(self) -> None:
        """Laser off, motor back to the start of the sweep; waits."""
        ...

    def start_sweep(self) -> None:
        """Laser on, motor on; returns."""
        ...

    def end_sweep(self) -> None:
        """As `stop`; raises DeviceError where the motor did not turn as far as it should have by now."""
        ...

    def stop(self) -> None:
        """Motor off and laser off, confirmed."""
        ...

    def sweep_time_s(self) -> float:
        """Forecast of one full sweep at the motor's nominal speed."""
        ...


@dataclass(frozen=True, slots=True)
class Rig:
    """Every device of one rig, opened together and closed in reverse, light sources first."""

    name: str
    clock: Clock
    axes: Mapping[str, Axis]
    lamps: Lamps
    cameras: Mapping[str, Camera]
    laser: LaserUnit | None
    closers: tuple["Closer", ...]

    def make_safe(self) -> list[str]:
        """Lamps and laser off, motion stopped, exposures dropped; each step is tried whatever fails before it.

        A wire that was lost is tried anew. A Ctrl-C or a termination waits for all of it, so that no light stays on
        because of a second one. Returns one line per device whose safe state could not be confirmed (empty: all
        confirmed).
        """
        actions = [("lamps", self.lamps.off)]
        if self.laser is not None:
            actions.append(("laser", self.laser.stop))
        actions += [(axis.name, axis.stop) for axis in self.axes.values()]
        actions += [(camera.name, camera.abort) for camera in self.cameras.values()]
        unconfirmed = []
        with postponed():
            for device, action in actions:
                try:
                    _insist(action)
                except Exception as error:  # noqa: BLE001 - whatever fails, the next lamp must still go off
                    unconfirmed.append(f"{device}: unconfirmed ({error})")
        return unconfirmed

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            for line in self.make_safe():
                log.error("%s", line)
        finally:
            for closer in self.closers:
                closer.close()


def _insist(action: Callable[[], None]) -> None:
    """Twice where the wire is lost: that may have gone unnoticed for long, and only the next use opens it anew."""
    try:
        action()
    except ReadTimeoutError:
        raise
    except TransportError:
        action()


class Closer(Protocol):
    """Something with a wire to close."""

    def close(self) -> None:
        """Close it; closing twice is allowed."""
        ...
