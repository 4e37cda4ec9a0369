"""Fault schedules: what goes wrong, at which message or time. Data, so that a run can be replayed.

A fault names a device: a wire (`bus`, `dmx`, `tower`), a camera, an axis or a lamp. Where an axis is named, faults of
messages strike the requests addressed to its module. Messages, frames and moves are counted from 1 at the start of the
process. A fault without `at_message` and `at_time_s` strikes at the next occasion.
"""

import tomllib
from collections import Counter
from collections.abc import Collection, Mapping
from enum import StrEnum
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from simulators.chance import uniform
from simulators.layout import PHONE, Layout


class FaultError(Exception):
    """A fault that cannot be: unknown device, kind or field."""


class Occasion(StrEnum):
    """What is counted, and so what a fault can strike."""

    MESSAGE = "message"
    FRAME = "frame"
    MOVE = "move"
    LAMP = "lamp"


KINDS: Mapping[str, Occasion] = {
    "lose": Occasion.MESSAGE,  # the request does not arrive
    "drop": Occasion.MESSAGE,  # the request is obeyed, the reply does not arrive
    "delay": Occasion.MESSAGE,  # the reply comes `seconds` later
    "stale": Occasion.MESSAGE,  # the reply comes just before the reply to the next request
    "duplicate": Occasion.MESSAGE,  # the reply comes twice
    "corrupt": Occasion.MESSAGE,  # one byte of the reply is changed
    "truncate": Occasion.MESSAGE,  # the second half of the reply is missing
    "nak": Occasion.MESSAGE,  # the device refuses with an error of its protocol
    "busy": Occasion.MESSAGE,  # a camera answers Device Busy
    "unplug": Occasion.MESSAGE,  # the wire is gone; it comes back after `seconds` of simulated time (0: never)
    "wrong_camera": Occasion.FRAME,  # the camera `other` sits on this cable
    "frozen": Occasion.FRAME,  # the frame before once more
    "dark": Occasion.FRAME,  # lamps and laser do not light this frame
    "no_frame": Occasion.FRAME,  # no object, no event
    "late": Occasion.FRAME,  # what follows in the burst comes `seconds` later
    "stall": Occasion.MOVE,  # the axis, or the laser's motor, stops half way
    "lost_steps": Occasion.MOVE,  # `steps` are counted but not made
    "dead_lamp": Occasion.LAMP,  # does not light from now on
}


class Fault(BaseModel):
    """One entry of the schedule; `count` successive occasions are struck, each with `probability`."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    device: str
    kind: str
    at_message: int | None = Field(default=None, ge=1)
    at_time_s: float | None = Field(default=None, ge=0)
    count: int = Field(default=1, ge=1)
    probability: float = Field(default=1.0, gt=0, le=1)
    seconds: float = Field(default=0.0, ge=0)
    steps: int = 0
    other: str = ""


def fault_devices(layout: Layout) -> dict[Occasion, tuple[str, ...]]:
    """The names that faults of each occasion can strike."""
    cameras, axes = (*layout.cameras, PHONE), tuple(layout.axes)
    return {
        Occasion.MESSAGE: ("bus", "dmx", "tower", *axes, *cameras),
        Occasion.FRAME: cameras,
        Occasion.MOVE: (*axes, "laser"),
        Occasion.LAMP: tuple(layout.lamps),
    }


class FaultSchedule:
    """The faults of a run and what has become of them."""

    def __init__(self, seed: int, devices: Mapping[Occasion, Collection[str]]) -> None:
        self._seed = seed
        self._devices = devices
        self._faults: list[Fault] = []
        self._struck: Counter[int] = Counter()
        self._seen: Counter[tuple[str, Occasion]] = Counter()

    def load(self, path: Path) -> None:
        """Add the faults of a TOML file, an array of tables `fault`. Raises FaultError."""
        try:
            entries = tomllib.loads(path.read_text(encoding="utf-8")).get("fault", [])
        except (OSError, ValueError) as error:
            raise FaultError(f"{path}: {error}") from error
        if not isinstance(entries, list):
            raise FaultError(f"{path}: 'fault' is no array of tables")
        for entry in entries:
            self.add(entry)

    def add(self, entry: Mapping[str, Any]) -> None:
        """Add one fault. Raises FaultError, which says what would be allowed."""
        try:
            fault = Fault.model_validate(entry)
        except ValidationError as error:
            first = error.errors()[0]
            raise FaultError(f"fault: {'.'.join(map(str, first['loc']))}: {first['msg']}") from error
        if fault.kind not in KINDS:
            raise FaultError(f"unknown fault kind {fault.kind!r}: one of {', '.join(KINDS)}")
        devices = self._devices[KINDS[fault.kind]]
        if fault.device not in devices:
            raise FaultError(f"no {fault.kind} of {fault.device!r}: one of {', '.join(devices)}")
        if fault.kind == "wrong_camera" and fault.other not in devices:
            raise FaultError(f"a wrong camera needs 'other', one of {', '.join(devices)}")
        self._faults.append(fault)

    def clear(self) -> None:
        """Mend everything; the counts go on."""
        self._faults.clear()
        self._struck.clear()

    def listed(self) -> list[dict[str, Any]]:
        """All faults with the number of times each has struck."""
        return [fault.model_dump() | {"struck": self._struck[i]} for i, fault in enumerate(self._faults)]

    def seen(self) -> dict[str, dict[str, int]]:
        """How many occasions of each kind each device has had."""
        counts: dict[str, dict[str, int]] = {}
        for (device, occasion), count in self._seen.items():
            counts.setdefault(device, {})[occasion.value] = count
        return counts

    def strike(self, devices: tuple[str, ...], occasion: Occasion, time_s: float) -> Fault | None:
        """Count an occasion for these devices (a wire and the device behind it); the fault that strikes, if any."""
        for device in devices:
            self._seen[device, occasion] += 1
        for index, fault in enumerate(self._faults):
            if fault.device in devices and KINDS[fault.kind] is occasion and self._due(index, fault, occasion, time_s):
                self._struck[index] += 1
                return fault
        return None

    def dead(self, lamp: str, time_s: float) -> bool:
        """Whether the lamp has died by now."""
        return any(
            fault.kind == "dead_lamp" and fault.device == lamp and time_s >= (fault.at_time_s or 0.0)
            for fault in self._faults
        )

    def _due(self, index: int, fault: Fault, occasion: Occasion, time_s: float) -> bool:
        number = self._seen[fault.device, occasion]
        if self._struck[index] >= fault.count or number < (fault.at_message or 0) or time_s < (fault.at_time_s or 0.0):
            return False
        return uniform(self._seed, "fault", index, number) < fault.probability
