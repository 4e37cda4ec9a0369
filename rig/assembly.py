"""Opening a rig: every device that rig.toml names, or none."""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from rig.config import RigConfig
from rig.devices import Axis, Camera, Rig
from rig.drivers.axis import StepperAxis
from rig.drivers.bus import TmclBus
from rig.drivers.camera import PtpCamera
from rig.drivers.clock import MonotonicClock, RigClock, SimulatedClock
from rig.drivers.lamps import EnttecLamps
from rig.drivers.laser_unit import RcxLaser
from rig.errors import RigError, UnknownDeviceError
from rig.sessions.lock import hold_rig

DeviceT = TypeVar("DeviceT")


def open_rig(config: RigConfig) -> Rig:
    """Open all devices and leave the rig dark and still. The rig is held until it is closed.

    Light sources come first, each of them whatever becomes of the other, so that what a crashed session left lit goes
    dark also where the rig cannot be opened. Raises BusyError that names the process
    that holds the rig, ConnectError, DeviceError; what was open by then is closed again.
    """
    with ExitStack() as stack:
        stack.enter_context(hold_rig(config))
        clock = _opened(stack, SimulatedClock(config.clock.address) if config.clock else MonotonicClock())
        lamps = _opened(stack, EnttecLamps(config.lamps, clock))
        laser = None if config.laser is None else _opened(stack, RcxLaser(config.laser, clock))
        _open_light_sources([lamps] if laser is None else [lamps, laser])
        return Rig(
            name=config.name,
            clock=clock,
            axes=_open_axes(stack, config, clock),
            lamps=lamps,
            cameras=_open_cameras(stack, config, clock),
            laser=laser,
            closers=(_Everything(stack.pop_all()),),
        )


@dataclass(frozen=True, slots=True)
class _Everything:
    """Closes all wires in the reverse order of opening, whatever fails on the way, and lets go of the rig."""

    stack: ExitStack

    def close(self) -> None:
        self.stack.close()


class _Closable(Protocol):
    def close(self) -> None: ...


class _Openable(Protocol):
    def open(self) -> None: ...


ClosableT = TypeVar("ClosableT", bound=_Closable)


class _Devices(dict[str, DeviceT], Generic[DeviceT]):
    """Devices by name; an unknown name tells the known ones."""

    def __missing__(self, name: str) -> DeviceT:
        raise UnknownDeviceError(f"no device {name!r} in rig.toml; it has {', '.join(self) or 'none of this kind'}.")


def _opened(stack: ExitStack, device: ClosableT) -> ClosableT:
    stack.callback(device.close)
    return device


def _open_light_sources(sources: Sequence[_Openable]) -> None:
    errors = []
    for source in sources:
        try:
            source.open()
        except RigError as error:
            errors.append(error)
    if errors:
        raise errors[0]


def _open_axes(stack: ExitStack, config: RigConfig, clock: RigClock) -> dict[str, Axis]:
    bus = _opened(stack, TmclBus(config.bus, clock))
    axes = _Devices[Axis]()
    for name, axis_config in config.axes.items():
        axis = StepperAxis(name, axis_config, bus, clock)
        axis.open()
        axes[name] = axis
    return axes


def _open_cameras(stack: ExitStack, config: RigConfig, clock: RigClock) -> dict[str, Camera]:
    cameras = _Devices[Camera]()
    for name, camera_config in config.cameras.items():
        camera = _opened(stack, PtpCamera(name, camera_config, clock))
        camera.open()
        cameras[name] = camera
    return cameras
