"""Opening a rig: all of it or nothing. Scripted devices answer just enough to be opened."""

import os

import pytest

from rig import load_config, open_rig
from rig.errors import BusyError, ConnectError, DeviceError, UnknownDeviceError
from tests.rig.drivers.peers import PtyPeer, TcpPeer, VirtualClock, cut_enttec, cut_fixed, cut_rcx
from tests.rig.drivers.ptp_peer import CameraPeer

TEXT = """
name = "scripted rig"
[holder]
sample_mm = 60.0
inner_mm = 76.0
outer_mm = 100.0
step_mm = 8.0
sample_depth_mm = 4.0
white_reflectance = 0.9
[board]
columns = 7
rows = 5
square_mm = 12.0
marker_mm = 9.0
[bus]
port = "{bus}"
[axes.arm]
module = 1
steps_per_deg = 100.0
min_deg = -90.0
max_deg = 90.0
speed_deg_s = 30.0
acceleration_deg_s2 = 60.0
[lamps]
port = "{dmx}"
[lamps.lamp.led]
channel = 9
mount = "arm"
elevation_deg = 0.0
distance_mm = 600.0
[cameras.front]
address = "{camera}"
serial = "VC-0000"
mount = "front"
elevation_deg = 0.0
distance_mm = 1000.0
[laser]
port = "{tower}"
distance_mm = 800.0
elevations_deg = [35.0]
sweep_ticks = 480
ticks_per_s = 39.2
"""


def answer_tmcl(request):
    """Status 100 and value 0 to everything."""
    body = bytes([2, request[0], 100, request[1]]) + bytes(4)
    return body + bytes([sum(body) & 0xFF])


def answer_rcx(request):
    """Every value is 0, every command is obeyed."""
    opcode = request[3]
    payload = bytes([opcode ^ 0xFF]) + (bytes(2) if opcode & ~8 == 0x12 else b"")
    body = payload + bytes([sum(payload) & 0xFF])
    return b"\x55\xff\x00" + b"".join(bytes([byte, byte ^ 0xFF]) for byte in body)


class World:
    """The scripted devices, and rig.toml that names them."""

    def __init__(self, folder):
        self.universes = []
        self.camera = CameraPeer(VirtualClock())
        self.bus = PtyPeer(folder / "bus", cut_fixed(9), answer_tmcl)
        self.dmx = PtyPeer(folder / "dmx", cut_enttec, self.answer_enttec)
        self.tower = PtyPeer(folder / "tower", cut_rcx, answer_rcx, echo=True)
        self.tcp = TcpPeer(self.camera.serve)
        ports = {"bus": self.bus.port, "dmx": self.dmx.port, "tower": self.tower.port, "camera": self.tcp.address}
        (folder / "rig.toml").write_text(TEXT.format(**ports))
        self.config = load_config(folder / "rig.toml")

    def answer_enttec(self, message):
        if message[1] == 6:
            self.universes.append(message[5:-1])
            return b""
        return bytes.fromhex("7e 0a 04 00 78 56 34 12 e7")

    def close(self):
        self.tcp.close()
        for peer in (self.bus, self.dmx, self.tower):
            peer.unplug()


@pytest.fixture
def world(tmp_path):
    world = World(tmp_path)
    yield world
    world.close()


def fail_while_lit(rig):
    rig.lamps.light({"led": 1.0})
    raise KeyError


def test_a_rig_opens_with_all_its_devices_dark(world):
    with open_rig(world.config) as rig:
        assert rig.name == "scripted rig"
        assert list(rig.axes) == ["arm"]
        assert list(rig.cameras) == ["front"]
        assert rig.lamps.names == ("led",)
        assert rig.laser is not None
        assert set(world.universes) == {bytes(24)}


def test_leaving_switches_lamps_and_laser_off_also_after_an_error(world):
    with pytest.raises(KeyError), open_rig(world.config) as rig:
        fail_while_lit(rig)
    assert world.universes[-1] == bytes(24)
    both_off = bytes.fromhex("55 ff 00 21 de 43 bc 64 9b"), bytes.fromhex("55 ff 00 29 d6 43 bc 6c 93")
    assert [request for request in world.tower.requests if request in both_off][1:], "once at opening, once at the end"


def test_a_rig_that_was_closed_opens_again(world):
    for _ in range(2):
        with open_rig(world.config):
            pass


def test_an_unknown_name_lists_the_known_ones(world):
    with open_rig(world.config) as rig:
        with pytest.raises(UnknownDeviceError, match=r"no device 'turntable' in rig.toml; it has arm"):
            rig.axes["turntable"]
        with pytest.raises(UnknownDeviceError, match="it has front"):
            rig.cameras["cam0"]
        assert "turntable" not in rig.axes


def test_a_second_opener_is_told_who_holds_the_rig(world):
    with open_rig(world.config) as rig:
        with pytest.raises(BusyError, match=rf"'scripted rig' is in use by process {os.getpid()}"):
            open_rig(world.config)
        rig.lamps.light({"led": 1.0})
        assert world.universes[-1][8] == 255, "the first one goes on undisturbed"


@pytest.mark.parametrize("serial", ["VC-0005"])
def test_when_the_last_device_fails_all_others_are_closed_and_the_rig_is_free(world, serial):
    world.camera.serial = serial
    with pytest.raises(DeviceError, match="found VC-0005"):
        open_rig(world.config)
    world.camera.serial = "VC-0000"
    with open_rig(world.config):
        assert not any(map(any, world.universes))


def test_a_port_that_is_not_there_is_told_and_frees_the_rig(world):
    world.bus.unplug()
    world.bus.link.unlink()
    with pytest.raises(ConnectError, match="bus: cannot open"):
        open_rig(world.config)
    world.bus.plug()
    with open_rig(world.config):
        pass


def test_what_cannot_be_made_safe_is_reported_and_the_rest_is_made_safe(world):
    with open_rig(world.config) as rig:
        rig.lamps.light({"led": 1.0})
        world.tower.unplug()
        lines = rig.make_safe()
        assert len(lines) == 1
        assert lines[0].startswith("laser: unconfirmed")
        assert world.universes[-1] == bytes(24)


@pytest.mark.parametrize("wire", ["bus", "dmx", "tower"])
def test_a_wire_that_was_lost_and_is_back_is_made_safe(world, wire):
    """An adapter that the system has dropped and found again, as they do when a motor starts beside them."""
    with open_rig(world.config) as rig:
        rig.lamps.light({"led": 1.0})
        getattr(world, wire).unplug()
        getattr(world, wire).plug()
        assert rig.make_safe() == []
        assert world.universes[-1] == bytes(24)


def test_lamps_that_cannot_be_opened_do_not_keep_the_laser_lit(world):
    """What a crash left on goes off as far as it can be reached."""
    world.dmx.unplug()
    world.dmx.link.unlink()
    with pytest.raises(ConnectError, match="lamps: cannot open"):
        open_rig(world.config)
    assert bytes.fromhex("55 ff 00 21 de 43 bc 64 9b") in world.tower.requests
    world.dmx.plug()
