"""How the devices take one step together; all of it in the control thread, the only one that commands devices.

The axes leave for the next pose as soon as the shutters are closed, while the frames are still being downloaded.
"""

from collections.abc import Callable, Iterator, Mapping
from math import isclose, nan

from rig.devices import LaserUnit, RawFrame, Rig
from rig.errors import DeviceError, UnknownDeviceError
from rig.sessions.forecast import LAMP_SETTLE_S, SHUTTER_LAG_S
from rig.sessions.step import Step

_SAME_RAD = 1e-9  # a thousandth of the finest axis' step
_SLICE_S = 0.5  # an abort waits no longer than this for an exposure


class Choreography:
    """The rig as a session uses it. `check_point` is called between device commands and may raise to abort."""

    def __init__(self, rig: Rig, check_point: Callable[[], None]) -> None:
        self._rig = rig
        self._check_point = check_point
        self._target_rad: dict[str, float] = {}
        self._reported_rad: dict[str, float] = {}
        self._moving: list[str] = []
        self._light: tuple[str, ...] | None = None

    @property
    def reported_rad(self) -> Mapping[str, float]:
        """The angles that the axes told after their last move."""
        return dict(self._reported_rad)

    def now_s(self) -> float:
        """The rig clock's time."""
        return self._rig.clock.now_s()

    def check(self, steps: tuple[Step, ...]) -> None:
        """Raises UnknownDeviceError, LimitError or InterlockError for any step; moves nothing."""
        wanted = {(name, angle) for step in steps for name, angle in step.axes_rad.items()}
        for kind, names, present in (
            ("axis", {name for name, _ in wanted}, self._rig.axes),
            ("camera", {name for step in steps for name in step.cameras}, self._rig.cameras),
            ("lamp", {name for step in steps for name in step.lamps}, self._rig.lamps.names),
        ):
            for name in sorted(names - set(present)):
                raise UnknownDeviceError(f"the open rig has no {kind} {name!r}; it has {', '.join(present)}.")
        if any(step.sweep for step in steps):
            self._laser()
        for name, angle_rad in sorted(wanted):
            self._rig.axes[name].check(angle_rad)

    def prepare(self) -> None:
        """Dark and still first, then every axis is homed: after a crash no angle can be trusted. Raises DeviceError."""
        unconfirmed = self._rig.make_safe()
        if unconfirmed:
            raise DeviceError(f"the rig cannot be made dark and still before the session: {'; '.join(unconfirmed)}")
        self._light = ()
        for name, axis in self._rig.axes.items():
            self._check_point()
            axis.home()
            self._reported_rad[name] = self._target_rad[name] = axis.angle_rad()

    def leave_for(self, step: Step) -> None:
        """Start the axes on their way to a step's pose; the next `pose` waits for them."""
        for name, angle_rad in step.axes_rad.items():
            if isclose(self._target_rad[name], angle_rad, abs_tol=_SAME_RAD):
                continue
            if name in self._moving:  # toward a step that has to wait for this one
                self._wait_for(name)
            self._check_point()
            self._rig.axes[name].move_to(angle_rad)
            self._target_rad[name] = angle_rad
            self._moving.append(name)

    def pose(self, step: Step) -> None:
        """Stand at the step's pose, lit as it wants, ready to expose."""
        self.leave_for(step)
        self._set_light(step.lamps)
        if step.sweep:
            self._check_point()
            self._laser().rewind()
        self.arrive()

    def arrive(self) -> None:
        """Wait for the axes that are on their way, and ask them where they are."""
        while self._moving:
            self._wait_for(self._moving[0])

    def expose(self, step: Step) -> None:
        """Start the exposures of all cameras, and for a sweep the laser."""
        self._check_point()
        if step.sweep:
            self._laser().start_sweep()
        for name in step.cameras:
            self._rig.cameras[name].expose(
                step.exposure_s, frames=step.frames, interval_s=step.interval_s, file_format=step.file_format
            )

    def see_out(self, step: Step, next_step: Step | None) -> None:
        """Let the exposures pass, and then what is to change does: the laser's sweep ends, axes leave.

        Only then the shutters' lag is waited for. Where the download takes less time than that lag, axes stay until it
        is over, because waiting would cost more than it saves.
        """
        self._sleep(step.duration_s)
        leaves = next_step is not None and next_step.pose != step.pose
        download_s = max(self._rig.cameras[name].transfer_time_s(step.frames) for name in step.cameras)
        if not step.sweep and not (leaves and download_s > SHUTTER_LAG_S):
            return
        self._sleep(SHUTTER_LAG_S)
        if step.sweep:
            self._laser().end_sweep()
        if next_step is not None and leaves:
            self.leave_for(next_step)

    def fetch(self, step: Step) -> Iterator[tuple[str, list[RawFrame]]]:
        """Download camera by camera."""
        for name in step.cameras:
            self._check_point()
            yield name, list(self._rig.cameras[name].fetch())

    def calm(self) -> None:
        """Everything off and still, as it is while the session holds; the next `pose` sets up anew."""
        self._set_light(())
        self.arrive()

    def drop(self) -> list[str]:
        """Drop what failed, so that the step can be taken again from the start; returns what went wrong with that."""
        problems = []
        actions = [camera.abort for camera in self._rig.cameras.values()]
        for action in [*actions, *([self._rig.laser.stop] if self._rig.laser else [])]:
            try:
                action()
            except Exception as error:  # noqa: BLE001 - the next device must be dropped all the same
                problems.append(str(error))
        self._light = None
        self._target_rad = dict.fromkeys(self._target_rad, nan)
        return problems

    def _wait_for(self, name: str) -> None:
        self._check_point()
        self._rig.axes[name].wait()
        self._reported_rad[name] = self._rig.axes[name].angle_rad()
        self._moving.remove(name)

    def _set_light(self, lamps: tuple[str, ...]) -> None:
        if lamps == self._light:
            return
        self._check_point()
        self._rig.lamps.light(dict.fromkeys(lamps, 1.0)) if lamps else self._rig.lamps.off()
        self._light = lamps
        self._rig.clock.sleep(LAMP_SETTLE_S)

    def _sleep(self, seconds: float) -> None:
        until_s = self._rig.clock.now_s() + seconds
        while (left_s := until_s - self._rig.clock.now_s()) > 1e-9:
            self._check_point()
            self._rig.clock.sleep(min(left_s, _SLICE_S))

    def _laser(self) -> LaserUnit:
        if self._rig.laser is None:
            raise UnknownDeviceError("the open rig has no laser unit, and the session sweeps one.")
        return self._rig.laser
