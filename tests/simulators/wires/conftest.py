"""A world in this process, at rate 0, with a darkroom that takes notes instead of rendering."""

import tomllib
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from simulators.clock import Clock
from simulators.faults import FaultSchedule, fault_devices
from simulators.layout import build_layout
from simulators.line import Line
from simulators.world import World

VECTORS = Path(__file__).parents[2] / "vectors"
SEED = 5


def load_vectors(name: str) -> dict[str, dict]:
    """The entries of a vector file by name, their bytes as `wire`."""
    tables = tomllib.loads((VECTORS / f"{name}.toml").read_text(encoding="utf-8"))
    entries = {entry["name"]: entry for table in tables.values() for entry in table}
    for entry in entries.values():
        text = entry.get("bytes") or f"{entry['bytes_start']} {'00 ' * entry['zeros']} {entry['bytes_end']}"
        entry["wire"] = bytes.fromhex(text)
    return entries


@dataclass
class Darkroom:
    """Files are numbers; the exposures that they are of are kept."""

    shots: list[dict] = field(default_factory=list)

    def photograph(self, camera, pose, exposure_s, *, serial, frame_key, time_s):
        self.shots.append(
            {
                "camera": camera,
                "pose": pose,
                "exposure_s": exposure_s,
                "serial": serial,
                "key": frame_key,
                "time_s": time_s,
            }
        )
        return f"frame {len(self.shots)} of {serial}".encode() * 8

    def photograph_jpeg(self, camera, pose, exposure_s, **label):
        return b"jpeg " + self.photograph(camera, pose, exposure_s, **label)

    def serial(self, camera):
        return "PH-0001" if camera == "phone" else build_layout(SEED, "small").cameras[camera].serial


@dataclass
class Wire:
    """A line of endless speed, and what was written to it."""

    line: Line
    sent: bytearray = field(default_factory=bytearray)
    unplugged: list[float] = field(default_factory=list)

    def __post_init__(self):
        self.line.write = self.sent.extend
        self.line.unplug = self.unplugged.append

    def take(self) -> bytes:
        """What was written since."""
        data = bytes(self.sent)
        self.sent.clear()
        return data


@pytest.fixture(scope="session")
def layout():
    return build_layout(SEED, "small")


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def faults(layout):
    return FaultSchedule(SEED, fault_devices(layout))


@pytest.fixture
def world(clock, faults, layout):
    return World(clock, faults, layout)


@pytest.fixture
def darkroom():
    return Darkroom()


@pytest.fixture
def wire(clock, faults):
    """Make a wire of a name; bytes take no time on it unless a speed is given."""
    return lambda name, bytes_per_s=1e12: Wire(Line(name, clock, faults, bytes_per_s))


@pytest.fixture(scope="session")
def vectors():
    return load_vectors
