"""The control port: one JSON object per line, for the simulated rig's clock, for an operator's hands, and for faults.

{"op": "now"}, {"op": "advance", "seconds": x}, {"op": "status"}, {"op": "power", "on": true} (the RCX' button),
{"op": "mount", "sample"?, "pose"?, "laser_elevation_deg"?, "card"?, "place"?, "facing"?}, {"op": "truth", "what", ...},
{"op": "fault", "device", "kind", ...}, {"op": "faults"}, {"op": "clear_faults"}.
A reply has "ok"; where that is false, "error" says why.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import radians
from typing import Any, ClassVar

from simulators.clock import Clock
from simulators.faults import FaultError, FaultSchedule
from simulators.laser_unit import Brick
from simulators.optics import Optics
from simulators.pose import Pose
from simulators.world import FRONT, Mounted, World


class ControlError(ValueError):
    """A request that makes no sense."""


@dataclass(frozen=True)
class Control:
    """What stands behind the control port."""

    clock: Clock
    world: World
    faults: FaultSchedule
    brick: Brick
    optics: Optics

    def answer(self, line: bytes) -> bytes:
        """The reply to one line, itself a line."""
        try:
            reply = {"ok": True} | self._obey(json.loads(line))
        except (FaultError, ValueError, TypeError, LookupError, ArithmeticError, OSError) as error:
            reply = {"ok": False, "error": str(error)}
        return json.dumps(reply).encode() + b"\n"

    def _obey(self, request: object) -> dict[str, Any]:
        if not isinstance(request, dict):
            raise ControlError("a request is a JSON object")
        arguments = dict(request)
        name = arguments.pop("op", None)
        handler = self._operations.get(str(name))
        if handler is None:
            raise ControlError(f"unknown op {name!r}: one of {', '.join(self._operations)}")
        return handler(self, arguments)

    def _now(self, _: Mapping[str, Any]) -> dict[str, Any]:
        return {"time_s": self.clock.now_s()}

    def _advance(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        self.clock.advance(float(arguments.get("seconds", 0.0)))
        return {"time_s": self.clock.now_s()}

    def _mount(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        known = ("sample", "pose", "laser_elevation_deg", "card", "place", "facing")
        if unknown := set(arguments) - set(known):
            raise ControlError(f"{sorted(unknown)[0]!r} is none of {', '.join(known)}")
        now = self.world.mounted
        mounted = Mounted(
            sample=arguments.get("sample", now.sample),
            board_pose=int(arguments.get("pose", now.board_pose)),
            laser_elevation_deg=float(arguments.get("laser_elevation_deg", now.laser_elevation_deg)),
            card=str(arguments.get("card", FRONT)),  # with whatever else is mounted, it goes back to its place
            place=str(arguments.get("place", now.place)),
            facing=str(arguments.get("facing", now.facing)),
        )
        self.world.mount(mounted)
        return {}

    def _status(self, _: Mapping[str, Any]) -> dict[str, Any]:
        return self.world.status() | {"rcx": self.brick.status()}

    def _power(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        self.brick.switch(on=bool(arguments.get("on", True)))
        return {}

    def _fault(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        self.faults.add(arguments)
        return {}

    def _faults(self, _: Mapping[str, Any]) -> dict[str, Any]:
        return {"faults": self.faults.listed(), "seen": self.faults.seen()}

    def _clear(self, _: Mapping[str, Any]) -> dict[str, Any]:
        self.faults.clear()
        return {}

    def _truth(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """Truth as things stand, or with "at": as if sample, axes and laser stood as it says; nothing moves."""
        wanted = {name: value for name, value in arguments.items() if name != "at"}
        return self.optics.truth(pose=_posed(self.world.pose(), arguments.get("at", {})), **wanted)

    _operations: ClassVar[dict[str, Callable[["Control", Mapping[str, Any]], dict[str, Any]]]] = {
        "now": _now,
        "advance": _advance,
        "mount": _mount,
        "status": _status,
        "power": _power,
        "fault": _fault,
        "faults": _faults,
        "clear_faults": _clear,
        "truth": _truth,
    }


def _posed(pose: Pose, at: Mapping[str, Any]) -> Pose:
    fields = {
        "turntable_deg": "turntable_rad",
        "light_arc_deg": "light_arc_rad",
        "arm_deg": "arm_rad",
        "laser_elevation_deg": "laser_elevation_rad",
        "card_elevation_deg": "card_elevation_rad",
    }
    unknown = set(at) - {*fields, "sample", "pose"}
    if unknown:
        raise ControlError(f"at: {sorted(unknown)[0]!r} is none of sample, pose, {', '.join(fields)}")
    angles: dict[str, Any] = {field: radians(float(at[name])) for name, field in fields.items() if name in at}
    board_pose = int(at.get("pose", pose.board_pose))
    return replace(pose, sample=str(at.get("sample", pose.sample)), board_pose=board_pose, **angles)
