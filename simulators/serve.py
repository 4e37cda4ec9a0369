"""All simulators of one rig behind their wires."""

import contextlib
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from simulators.axes import Bus, Module
from simulators.camera import MOUNTED, Camera, phone_make
from simulators.clock import Clock
from simulators.control import Control
from simulators.faults import FaultSchedule, fault_devices
from simulators.lamps import Widget
from simulators.laser_unit import Brick, Tower
from simulators.layout import PHONE, CameraLabel
from simulators.line import Line
from simulators.optics import Optics
from simulators.phone import SPEEDS
from simulators.ptp_ip import Responder
from simulators.rig_file import rig_toml
from simulators.shutter import Shutter
from simulators.wires import HEAD_START_S, Loop, Pty, TcpConnection, TcpPort
from simulators.world import World

# Bytes per second: 9600 baud with 8 data bits and none for parity, full-speed USB, 2400 baud with odd parity.
SERIAL_WIRES = {"bus": 9600 / 10, "dmx": 1e6, "tower": 2400 / 11}
RANKS = {"dmx": 0, "bus": 1, "tower": 2, "camera": 3, "control": 4}  # lamps answer nothing, so they are heard first
STDIN = 0


@dataclass(frozen=True)
class Settings:
    """What the command line says."""

    state: Path
    seed: int = 1
    rate: float = 0.0
    ptp_port: int = 0
    size: str = "small"
    faults: Path | None = None


class Laboratory:
    """One rig's worth of simulators: a clock, a world, and a wire for each device."""

    def __init__(self, settings: Settings) -> None:
        state = settings.state.resolve()
        (state / "truth").mkdir(parents=True, exist_ok=True)
        self.clock = Clock(settings.rate)
        self.loop = Loop(self.clock)
        self.optics = Optics(settings.seed, settings.size, state / "truth")
        self.layout = self.optics.layout
        self.faults = FaultSchedule(settings.seed, fault_devices(self.layout))
        if settings.faults is not None:
            self.faults.load(settings.faults)
        self.world = World(self.clock, self.faults, self.layout)
        self.brick = Brick(self.clock, self.world)
        self._ports: list[Pty | TcpPort] = []
        self._open_serial(state)
        labels: list[CameraLabel] = [*self.layout.cameras.values(), self.optics.phone.layout]
        cameras = {label.name: self._open_camera(label, i, settings.ptp_port) for i, label in enumerate(labels)}
        self.rig_toml = state / "rig.toml"
        serial = {name: str(state / name) for name in SERIAL_WIRES}
        text = rig_toml(
            self.layout, self.optics.phone.layout, serial=serial, cameras=cameras, clock=self._open_control()
        )
        self.rig_toml.write_text(text, encoding="utf-8")

    def run(self) -> None:
        """Serve until the standard input ends; a file there is no parent and does not count."""
        with contextlib.suppress(PermissionError):
            self.loop.add(STDIN, 0, self._parent)
        self.loop.run()

    def close(self) -> None:
        """Take all wires away."""
        for port in self._ports:
            port.close()

    def _parent(self, _mask: int) -> None:
        if not os.read(STDIN, 4096):
            self.loop.stop()

    def _open_serial(self, state: Path) -> None:
        bus, dmx, tower = (Line(name, self.clock, self.faults, rate) for name, rate in SERIAL_WIRES.items())
        modules = {axis.module: Module(axis.module, self.world.stages[name]) for name, axis in self.layout.axes.items()}
        self._open_pty(state, bus, Bus(bus, modules).receive)
        self._open_pty(state, dmx, Widget(dmx, self.world.lamps).receive)
        self._open_pty(state, tower, Tower(tower, self.brick).receive)

    def _open_pty(self, state: Path, line: Line, receive: Callable[[bytes, float], None]) -> None:
        port = Pty(self.loop, state / line.name, RANKS[line.name], receive)
        line.write, line.unplug = port.write, port.unplug
        self._ports.append(port)

    def _open_camera(self, label: CameraLabel, index: int, port_number: int) -> str:
        """Open a camera's port and tell its address."""
        make = phone_make(SPEEDS) if label.name == PHONE else MOUNTED
        camera = Camera(label, Shutter(label, self.world, self.optics), self.clock.now_s, make)
        line = Line(label.name, self.clock, self.faults, label.megabytes_per_s * 1e6)
        responder = Responder(camera, line)
        address = (f"127.0.0.{index + 1}" if port_number else "127.0.0.1", port_number)
        port = TcpPort(self.loop, address, RANKS["camera"], responder.receive, responder.lost)
        line.unplug = port.unplug
        self._ports.append(port)
        return port.address

    def _open_control(self) -> str:
        control = Control(self.clock, self.world, self.faults, self.brick, self.optics)
        pending: dict[TcpConnection, bytes] = {}

        def receive(connection: TcpConnection, data: bytes) -> None:
            self.loop.serve(HEAD_START_S, highest_rank=RANKS["tower"])
            *lines, pending[connection] = (pending.get(connection, b"") + data).split(b"\n")
            for line in lines:
                connection.write(control.answer(line))

        def lost(connection: TcpConnection) -> None:
            pending.pop(connection, None)

        port = TcpPort(self.loop, ("127.0.0.1", 0), RANKS["control"], receive, lost)
        self._ports.append(port)
        return port.address


def serve(settings: Settings) -> None:
    """Run the simulators; says `ready` and where rig.toml is once every wire is there."""
    laboratory = Laboratory(settings)
    try:
        sys.stdout.write(f"ready {laboratory.rig_toml}\n")
        sys.stdout.flush()
        laboratory.run()
    finally:
        laboratory.close()
