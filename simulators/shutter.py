"""What happens inside a camera between release and memory: exposures in simulated time, one after the other."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

from simulators.chance import Key
from simulators.clock import NS_PER_S, Event
from simulators.faults import Occasion
from simulators.layout import CameraLabel
from simulators.pose import Pose
from simulators.world import World

READOUT_S = 0.02
TICK_S = 1e-4  # PTP counts exposure times in tenths of a millisecond


class Darkroom(Protocol):
    """What makes files of exposures; `simulators.optics.Optics` does."""

    def photograph(
        self, camera: str, pose: Pose, exposure_s: float, *, serial: str, frame_key: Key, time_s: float
    ) -> bytes:
        """A DNG of what the camera sees."""
        ...

    def photograph_jpeg(
        self, camera: str, pose: Pose, exposure_s: float, *, serial: str, frame_key: Key, time_s: float
    ) -> bytes:
        """A JPEG of it."""
        ...

    def serial(self, camera: str) -> str:
        """What is engraved on a camera."""
        ...


@dataclass(frozen=True, slots=True)
class Exposure:
    """One frame under way; it shows the world at the middle of its time."""

    index: int
    start_ns: int
    fan_start_rad: float
    pose: Pose
    key: Key


@dataclass
class Release:
    """A press on the button: so many frames, and what to do with them."""

    exposure_s: float
    jpeg: bool
    frames: int
    interval_s: float
    deliver: Callable[[bytes], None]
    complete: Callable[[], None]
    due: Event | None = None  # what happens next
    late_s: float = 0.0  # by which the next frame misses its time


class Shutter:
    """Shutter and sensor of one camera."""

    def __init__(self, camera: CameraLabel, world: World, darkroom: Darkroom) -> None:
        self._camera = camera
        self._world = world
        self._clock = world.clock
        self._darkroom = darkroom
        self._release: Release | None = None
        self._last = b""

    @property
    def busy(self) -> bool:
        """Whether an exposure or a burst is under way."""
        return self._release is not None

    def release(self, release: Release) -> None:
        """Start the exposures: the first one now."""
        self._release = release
        self._open(release, 0)

    def abort(self) -> None:
        """Drop what is under way; nothing of it is delivered."""
        if self._release is not None and self._release.due is not None:
            self._release.due.cancel()
        self._release = None

    def _open(self, release: Release, index: int) -> None:
        start_ns, fan_start_rad = self._clock.now_ns(), self._world.fan_rad()
        length_ns = round(release.exposure_s * NS_PER_S)
        ticks = round(release.exposure_s / TICK_S)
        exposure_key = ticks if round(ticks * TICK_S * NS_PER_S) == length_ns else f"{length_ns} ns"

        def middle() -> None:
            key = self._world.frame_key(self._camera.serial, exposure_key, index)
            exposure = Exposure(index, start_ns, fan_start_rad, self._world.pose(), key)
            release.due = self._clock.at(start_ns + length_ns, lambda: self._close(release, exposure))

        release.due = self._clock.at(start_ns + length_ns // 2, middle)

    def _close(self, release: Release, exposure: Exposure) -> None:
        pose = exposure.pose
        if pose.laser_on:
            pose = replace(pose, laser_sweep=(exposure.fan_start_rad, self._world.fan_rad()))
        image = self._develop(release, exposure, pose)
        release.due = self._clock.after(READOUT_S, lambda: self._read_out(release, exposure, image))

    def _develop(self, release: Release, exposure: Exposure, pose: Pose) -> bytes | None:
        camera = self._camera.name
        fault = self._world.faults.strike((camera,), Occasion.FRAME, self._clock.now_s())
        match fault.kind if fault else None:
            case "no_frame":
                return None
            case "late":
                release.late_s = fault.seconds if fault else 0.0
            case "frozen" if self._last:
                return self._last
            case "dark":
                pose = replace(pose, lamps=(), laser_on=False, laser_sweep=None)
            case "wrong_camera":
                camera = fault.other if fault else camera
        develop = self._darkroom.photograph_jpeg if release.jpeg else self._darkroom.photograph
        self._last = develop(
            camera,
            pose,
            release.exposure_s,
            serial=self._darkroom.serial(camera),
            frame_key=exposure.key,
            time_s=exposure.start_ns / NS_PER_S,
        )
        return self._last

    def _read_out(self, release: Release, exposure: Exposure, image: bytes | None) -> None:
        last = exposure.index + 1 == release.frames
        if last:
            self._release = None
        if image is not None:
            release.deliver(image)
        if last:
            if image is not None:
                release.complete()
            return
        next_ns = exposure.start_ns + round((release.interval_s + release.late_s) * NS_PER_S)
        release.late_s = 0.0
        release.due = self._clock.at(next_ns, lambda: self._open(release, exposure.index + 1))
