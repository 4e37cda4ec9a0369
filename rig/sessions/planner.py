"""From a plan to ordered steps that this rig can take; every angle and way is checked before anything moves."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from math import ceil

from rig.config import LampConfig, LaserConfig, RigConfig
from rig.devices import FileFormat
from rig.errors import InterlockError, PlanError, UnknownDeviceError
from rig.sessions.exposure import longest_s, with_tests
from rig.sessions.order import FACINGS, ordered
from rig.sessions.plan import (
    BtfPlan,
    CalibratePlan,
    EnvironmentPlan,
    LampsPlan,
    MdfPlan,
    Plan,
    SensorPlan,
    SrfPlan,
    in_steps_s,
)
from rig.sessions.reach import reachable_deg, standby_deg
from rig.sessions.step import Mount, Step, step_id, to_rad

FRONT_BLOCKED_DEG = 5.0  # the 50 mm sphere at 1.1 m fills +-2.6 deg of the front camera; the rest is the lamp's housing
SWEEP_ID = "sweep"
CAP, LIGHT_BOX = "cap", "lightbox"  # what a plan of kind sensor has mounted before every lens


@dataclass(frozen=True, slots=True)
class Skip:
    """Something that the plan names and the rig's geometry cannot use, and why."""

    what: str
    reason: str


@dataclass(frozen=True, slots=True)
class Schedule:
    """The steps in the order in which they are taken, and what was left out."""

    steps: tuple[Step, ...]
    skipped: tuple[Skip, ...]


def expand(plan: Plan, config: RigConfig) -> tuple[Step, ...]:
    """The steps of `schedule`."""
    return schedule(plan, config).steps


def schedule(plan: Plan, config: RigConfig) -> Schedule:
    """Every step of the plan, ordered so that the operator mounts least and slow axes move least.

    The result depends on the plan's content, not on the order of its lists. Raises UnknownDeviceError for a name that
    is not in rig.toml, LimitError and InterlockError for an angle that an axis cannot take, PlanError where no step is
    left or two are the same.
    """
    layout = _Layout(config)
    match plan:
        case SrfPlan():
            steps = list(_srf(plan, layout))
        case BtfPlan():
            steps = list(_btf(plan, layout))
        case MdfPlan():
            steps = list(_mdf(plan, layout))
        case CalibratePlan():
            steps = list(_calibrate(plan, layout))
        case SensorPlan():
            steps = list(_sensor(plan, layout))
        case LampsPlan():
            steps = list(_lamps(plan, layout))
        case EnvironmentPlan():
            steps = list(_environment(plan, layout))
    skipped = tuple(sorted(set(layout.skipped), key=lambda skip: (skip.what, skip.reason)))
    _check_identity(steps, skipped)
    taken = ordered(steps, config)
    untold = isinstance(plan, MdfPlan) and plan.exposure_s is None
    return Schedule(with_tests(taken) if untold else taken, skipped)


class _Layout:
    """The rig's parts by name, and the reasons for what is skipped."""

    def __init__(self, config: RigConfig) -> None:
        self.config = config
        self.skipped: list[Skip] = []

    def axes_deg(self, wanted_deg: Mapping[str, float]) -> dict[str, float]:
        """Angles of all axes of the rig: the wanted ones where the axis can take them, the others on standby."""
        for name in wanted_deg:
            _known("axis", name, self.config.axes)
        return {
            name: reachable_deg(name, axis, wanted_deg[name]) if name in wanted_deg else standby_deg(name, axis)
            for name, axis in self.config.axes.items()
        }

    def lamp(self, name: str) -> LampConfig:
        """Raises UnknownDeviceError."""
        _known("lamp", name, self.config.lamps.lamp)
        return self.config.lamps.lamp[name]

    def laser(self) -> LaserConfig:
        """Raises UnknownDeviceError where the rig has none."""
        if self.config.laser is None:
            raise UnknownDeviceError(
                "the rig has no laser unit: rig.toml has no [laser]. A plan of kind mdf needs one."
            )
        return self.config.laser

    def cameras(self, names: Iterable[str], *, flat_sample: bool) -> tuple[str, ...]:
        """In the order of rig.toml, without those that would look at a flat sample from its edge or from below."""
        wanted = set(names)
        for name in sorted(wanted):
            _known("camera", name, self.config.cameras)
            if self.config.cameras[name].mount == "hand":
                raise PlanError(f"camera {name} is held by hand: it serves plans of kind environment alone.")
        chosen = [name for name in self.config.cameras if name in wanted]
        for name in list(chosen):
            elevation_deg = self.config.cameras[name].elevation_deg
            if flat_sample and elevation_deg <= 0:
                chosen.remove(name)
                self.skip(f"camera {name}", f"at {elevation_deg:g} deg it does not see the upper side of a flat sample")
        return tuple(chosen)

    def held_camera(self, name: str) -> str:
        """Raises UnknownDeviceError, or PlanError for a camera that is mounted."""
        _known("camera", name, self.config.cameras)
        if self.config.cameras[name].mount != "hand":
            raise PlanError(f"field camera: {name} is mounted; a place is photographed by a camera in the hand.")
        return name

    def skip(self, what: str, reason: str) -> None:
        """Note what is left out."""
        self.skipped.append(Skip(what, reason))


def _srf(plan: SrfPlan, layout: _Layout) -> Iterator[Step]:
    """Pose by pose, in each under every lamp that is carried there."""
    cameras = layout.cameras([plan.camera], flat_sample=False)
    at_front = layout.config.cameras[plan.camera].mount == "front"
    mount = {"sample": plan.sample} | ({} if at_front else {"card": plan.camera})
    for carrier, angles_deg in (("arm", plan.arm_deg), ("light_arc", plan.light_arc_deg)):
        lamps = _carried(plan, carrier, layout, wanted=bool(angles_deg))
        for angle_deg in sorted(angles_deg):
            if carrier == "arm" and at_front and abs(angle_deg) < FRONT_BLOCKED_DEG:
                layout.skip(f"arm {angle_deg:g} deg", f"the arm would stand before camera {plan.camera}")
                continue
            aside_deg = _arm_aside(angle_deg, layout) if at_front and carrier == "light_arc" else {}
            pose = _Pose(mount, layout.axes_deg({carrier: angle_deg, **aside_deg}), (carrier,), cameras)
            for lamp in lamps:
                yield from pose.photographs(lamp, plan.exposures_s)


def _carried(plan: SrfPlan, carrier: str, layout: _Layout, *, wanted: bool) -> list[str]:
    """The plan's lamps on this axis. Raises PlanError for lamps without angles of it, and for angles without lamps."""
    lamps = [name for name in plan.lamp_names() if layout.lamp(name).mount == carrier]
    if lamps and not wanted:
        raise PlanError(f"field {carrier}_deg: {lamps[0]} sits on the {carrier}, and the plan names no angles of it.")
    if wanted and not lamps:
        raise PlanError(f"field {carrier}_deg: none of {', '.join(plan.lamp_names())} sits on the {carrier}.")
    return lamps


def _arm_aside(light_deg: float, layout: _Layout) -> dict[str, float]:
    """Where the arm, if there is one, neither blocks the front camera's view nor stands in the light arc's light."""
    arm = layout.config.axes.get("arm")
    return {} if arm is None else {"arm": arm.min_deg if light_deg > 0 else arm.max_deg}


def _btf(plan: BtfPlan, layout: _Layout) -> Iterator[Step]:
    cameras = layout.cameras(plan.cameras, flat_sample=True)
    lamps = [name for name in plan.lamps if _lights_flat_sample(name, layout)]
    for turntable_deg in sorted(plan.turntable_deg) if cameras else ():
        for azimuth_deg in sorted(plan.light_azimuth_deg):
            wanted_deg = {"turntable": turntable_deg, "light_arc": _wrapped(azimuth_deg + turntable_deg)}
            try:
                axes_deg = layout.axes_deg(wanted_deg)
            except InterlockError as error:
                layout.skip(f"turntable {turntable_deg:g} deg, light azimuth {azimuth_deg:g} deg", str(error))
                continue
            pose = _Pose({"sample": plan.sample}, axes_deg, ("turntable", "light_arc"), cameras)
            for lamp in lamps:
                yield from pose.photographs(lamp, plan.exposures_s)


def _mdf(plan: MdfPlan, layout: _Layout) -> Iterator[Step]:
    laser = layout.laser()
    unknown = sorted(set(plan.laser_elevations_deg) - set(laser.elevations_deg))
    if unknown:
        known = ", ".join(f"{angle:g}" for angle in laser.elevations_deg)
        raise PlanError(f"field laser_elevations_deg: no mounting at {unknown[0]:g} deg; rig.toml has {known}.")
    cameras = layout.cameras(plan.cameras, flat_sample=True)
    frames = ceil(laser.sweep_ticks / laser.ticks_per_s * plan.frame_rate_hz)
    for elevation_deg, azimuths_deg in plan.mountings_deg() if cameras else ():
        mount: Mount = {"sample": plan.sample, "laser_elevation_deg": elevation_deg}
        for turntable_deg in sorted(plan.turntable_deg):
            for azimuth_deg in sorted(azimuths_deg):
                axes_deg = layout.axes_deg({"turntable": turntable_deg, "light_arc": azimuth_deg})
                pose = _Pose(mount, axes_deg, ("turntable", "light_arc"), cameras)
                yield pose.sweep(plan.exposure_s, frames, 1 / plan.frame_rate_hz)


def _calibrate(plan: CalibratePlan, layout: _Layout) -> Iterator[Step]:
    cameras = layout.cameras(plan.cameras, flat_sample=True)
    if layout.lamp(plan.lamp).mount != "light_arc":
        raise PlanError(f"field lamp: {plan.lamp} sits on the arm; a plan of kind calibrate sets the light arc.")
    axes_deg = layout.axes_deg({"light_arc": plan.light_arc_deg})
    for board_pose in range(plan.board_poses) if cameras else ():
        pose = _Pose({"sample": "charuco", "pose": board_pose}, axes_deg, ("light_arc",), cameras)
        yield from pose.photographs(plan.lamp, (plan.exposure_s,))
    for turntable_deg in sorted(plan.turntable_deg) if cameras else ():
        turned_deg = layout.axes_deg({"turntable": turntable_deg, "light_arc": plan.light_arc_deg})
        if turned_deg != axes_deg:  # else it is pose 0 as above
            pose = _Pose({"sample": "charuco", "pose": 0}, turned_deg, ("turntable", "light_arc"), cameras)
            yield from pose.photographs(plan.lamp, (plan.exposure_s,))


def _sensor(plan: SensorPlan, layout: _Layout) -> Iterator[Step]:
    """Round after round of all exposures, so that a light that drifts shows between equal exposures far apart."""
    cameras = layout.cameras(plan.cameras, flat_sample=False)
    axes_deg = layout.axes_deg({})
    for before_lens, exposures_s in ((CAP, plan.dark_exposures_s), (LIGHT_BOX, plan.flat_exposures_s)):
        pose = _Pose({"sample": before_lens}, axes_deg, (), cameras)
        for repeat in range(plan.repeats):
            yield from pose.unlit(f"{before_lens}{repeat:02d}", map(in_steps_s, sorted(exposures_s, reverse=True)))


def _lamps(plan: LampsPlan, layout: _Layout) -> Iterator[Step]:
    cameras = layout.cameras(plan.cameras, flat_sample=True)
    for lamp in plan.lamps if cameras else ():
        carrier, samples = layout.lamp(lamp).mount, _reference_samples(plan, lamp, layout)
        angles_deg = plan.arm_deg if carrier == "arm" else plan.light_arc_deg
        if not angles_deg:
            layout.skip(f"lamp {lamp}", f"the plan names no {carrier}_deg, angles of the axis that carries it")
        for angle_deg in sorted(angles_deg):
            axes_deg = layout.axes_deg({carrier: angle_deg})
            for sample, exposures_s in samples.items():
                pose = _Pose({"sample": sample}, axes_deg, (carrier,), cameras, label=f"{sample}_")
                yield from pose.photographs(lamp, exposures_s)


def _reference_samples(plan: LampsPlan, lamp: str, layout: _Layout) -> dict[str, tuple[float, ...]]:
    """Which samples of the plan show this lamp, and how long they are exposed."""
    samples = {} if plan.mirror is None else {plan.mirror.sample: plan.mirror.exposures_s}
    if plan.white is not None and layout.lamp(lamp).elevation_deg > 0:
        samples[plan.white.sample] = plan.white.exposures_s
    if not samples:
        layout.skip(f"lamp {lamp}", "it stands under the horizon of the white plate, and there is no mirror")
    return samples


def _environment(plan: EnvironmentPlan, layout: _Layout) -> Iterator[Step]:
    """Front and back, from the longest exposure to the shortest; the rig stands by, dark."""
    cameras, axes_deg = (layout.held_camera(plan.camera),), layout.axes_deg({})
    file_format = FileFormat.JPEG if plan.files == "jpeg" else FileFormat.RAW
    for facing in FACINGS:
        pose = _Pose({"place": plan.place, "facing": facing}, axes_deg, (), cameras)
        for step in pose.unlit(facing, sorted(plan.exposures_s, reverse=True)):
            yield replace(step, file_format=file_format)


@dataclass(frozen=True, slots=True)
class _Pose:
    """What stays the same while lamps and exposures change; `named` are the axes that the plan speaks of."""

    mount: Mount
    axes_deg: Mapping[str, float]
    named: tuple[str, ...]
    cameras: tuple[str, ...]
    label: str = ""  # before the light's name, where the sample is no matter of course

    def photographs(self, lamp: str, exposures_s: Iterable[float]) -> Iterator[Step]:
        for exposure_s in map(in_steps_s, exposures_s):
            yield Step(
                self._id(lamp, exposure_s), self._axes_rad(), (lamp,), exposure_s, self.cameras, mount=self.mount
            )

    def unlit(self, name: str, exposures_s: Iterable[float]) -> Iterator[Step]:
        for exposure_s in exposures_s:
            yield Step(self._id(name, exposure_s), self._axes_rad(), (), exposure_s, self.cameras, mount=self.mount)

    def sweep(self, exposure_s: float | None, frames: int, interval_s: float) -> Step:
        """An exposure that is still to be chosen is no part of the identity, and the longest possible until then."""
        told_s = None if exposure_s is None else in_steps_s(exposure_s)
        return Step(
            self._id(SWEEP_ID, told_s), self._axes_rad(), (), told_s or longest_s(interval_s), self.cameras,
            frames=frames, interval_s=interval_s, sweep=True, mount=self.mount,
        )  # fmt: skip

    def _id(self, light: str, exposure_s: float | None) -> str:
        return step_id(self.mount, {name: self.axes_deg[name] for name in self.named}, self.label + light, exposure_s)

    def _axes_rad(self) -> dict[str, float]:
        return to_rad(self.axes_deg)


def _lights_flat_sample(name: str, layout: _Layout) -> bool:
    lamp = layout.lamp(name)
    if lamp.elevation_deg <= 0:
        layout.skip(f"lamp {name}", f"at {lamp.elevation_deg:g} deg it is under the horizon of a flat sample")
        return False
    if lamp.mount != "light_arc":
        raise PlanError(f"field lamps: {name} sits on the arm; a plan of kind btf turns the light arc.")
    return True


def _wrapped(angle_deg: float) -> float:
    """The same direction in (-180, 180]."""
    return -((180.0 - angle_deg) % 360.0 - 180.0)


def _known(kind: str, name: str, known: Iterable[str]) -> None:
    if name not in known:
        raise UnknownDeviceError(f"no {kind} named {name!r} in rig.toml; known: {', '.join(known)}.")


def _check_identity(steps: list[Step], skipped: tuple[Skip, ...]) -> None:
    if not steps:
        reasons = "; ".join(f"{skip.what}: {skip.reason}" for skip in skipped[:3])
        raise PlanError(f"no step is left of the plan. {reasons}")
    twice = [name for name, count in Counter(step.id for step in steps).items() if count > 1]
    if twice:
        raise PlanError(f"two steps would be the same: {twice[0]}. Angles or exposures of the plan are too close.")
