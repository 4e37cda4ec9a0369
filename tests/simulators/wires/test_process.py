"""The whole process from outside: its wires, its ends, and that the same seed gives the same bits."""

import json
import os
import signal
import socket
import struct
import subprocess
import sys
from pathlib import Path

import pytest
import rawpy
import serial

from rig.config import load_config

GET_POSITION = bytes.fromhex("01 06 01 00 00 00 00 00 08")
ROOT = Path(__file__).parents[3]


class PtpHost:
    """A host that speaks just enough PTP/IP to take a picture."""

    def __init__(self, address):
        host, port = address.split(":")
        self._command = socket.create_connection((host, int(port)), timeout=30)
        self._transaction = 0
        self._send(1, bytes(16) + b"t\0\0\0" + struct.pack("<I", 0x10000))
        self._receive()
        assert self.operate(0x1002, 1)[0] == 0x2001

    def operate(self, code, *parameters, data=None):
        self._transaction += 1
        head = struct.pack("<IHI", 1 if data is None else 2, code, self._transaction)
        self._send(6, head + struct.pack(f"<{len(parameters)}I", *parameters))
        if data is not None:
            self._send(9, struct.pack("<IQ", self._transaction, len(data)))
            self._send(12, struct.pack("<I", self._transaction) + data)
        answer = b""
        while True:
            kind, body = self._receive()
            answer += body[4:] if kind in (10, 12) else b""
            if kind == 7:
                return struct.unpack_from("<H", body)[0], answer

    def close(self):
        self._command.close()

    def _send(self, kind, body):
        self._command.sendall(struct.pack("<II", len(body) + 8, kind) + body)

    def _receive(self):
        length, kind = struct.unpack("<II", self._exactly(8))
        return kind, self._exactly(length - 8)

    def _exactly(self, count):
        data = b""
        while len(data) < count:
            more = self._command.recv(count - len(data))
            assert more, "the camera hung up"
            data += more
        return data


def light(rig, levels):
    """Set the lamps and wait for the widget's answer to the question behind."""
    universe = bytes([0, *levels]).ljust(25, b"\0")
    with serial.Serial(str(rig.state / "dmx"), timeout=5) as port:
        port.write(bytes([0x7E, 6, len(universe), 0]) + universe + b"\xe7" + bytes.fromhex("7e 0a 00 00 e7"))
        assert len(port.read(9)) == 9


def photograph(rig, camera, ticks=200):
    """The file of one exposure."""
    host = PtpHost(rig.camera_address(camera))
    try:
        assert host.operate(0x1016, 0x500D, data=struct.pack("<I", ticks))[0] == 0x2001
        assert host.operate(0x100E)[0] == 0x2001
        rig.control("advance", seconds=1.0)
        (_, handles) = host.operate(0x1007, 0xFFFFFFFF)
        return host.operate(0x1009, struct.unpack_from("<I", handles, len(handles) - 4)[0])[1]
    finally:
        host.close()


def pixels(file, tmp_path):
    path = tmp_path / "frame.dng"
    path.write_bytes(file)
    with rawpy.imread(str(path)) as raw:
        return raw.raw_image.copy()


def test_rig_toml_is_what_the_rig_reads(shared_simulated_rig):
    config = load_config(shared_simulated_rig.toml)
    assert len(config.cameras) == 10
    assert config.clock.address == shared_simulated_rig.control.address
    assert Path(config.bus.port).is_char_device()
    assert Path(config.lamps.port).is_char_device()
    assert Path(config.laser.port).is_char_device()


def test_axis_answers_on_the_bus(shared_simulated_rig):
    before_s = shared_simulated_rig.control("now")["time_s"]
    with serial.Serial(str(shared_simulated_rig.state / "bus"), 9600, timeout=5) as port:
        port.write(GET_POSITION)
        assert port.read(9) == bytes.fromhex("02 01 64 06 00 00 00 00 6d")
    assert shared_simulated_rig.control("now")["time_s"] - before_s == pytest.approx(18 / 960, abs=1e-6)


def test_time_moves_only_when_told(shared_simulated_rig):
    before_s = shared_simulated_rig.control("now")["time_s"]
    assert shared_simulated_rig.control("now")["time_s"] == before_s
    assert shared_simulated_rig.control("advance", seconds=2.5)["time_s"] == pytest.approx(before_s + 2.5)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (b"nonsense", "Expecting value"),
        (b"[1]", "JSON object"),
        (b"{}", "unknown op None"),
        (b'{"op": ["now"]}', "unknown op"),
        (b'{"op": "fly"}', "unknown op 'fly': one of now"),
        (b'{"op": "advance", "seconds": -1}', "cannot go back"),
        (b'{"op": "advance", "seconds": "soon"}', "could not convert"),
        (b'{"op": "advance", "seconds": Infinity}', "infinity"),
        (b'{"op": "mount", "sample": "cake"}', "no sample 'cake'"),
        (b'{"op": "mount", "pose": -1}', "no board pose -1"),
        (b'{"op": "mount", "laser_elevation_deg": 12}', "no laser mounting at 12"),
        (b'{"op": "mount", "tripod": 1}', "'tripod' is none of"),
        (b'{"op": "fault", "device": "bus"}', "kind"),
        (b'{"op": "truth", "what": "meaning"}', "meaning"),
        (b'{"op": "truth"}', "what"),
    ],
)
def test_senseless_requests_are_refused_and_change_nothing(shared_simulated_rig, line, message):
    host, port = shared_simulated_rig.control.address.split(":")
    before = shared_simulated_rig.control("status")
    with socket.create_connection((host, int(port)), timeout=10) as stream, stream.makefile("rb") as lines:
        stream.sendall(line + b"\n" + b'{"op": "now"}\n')
        refusal, good = json.loads(lines.readline()), json.loads(lines.readline())
    assert not refusal["ok"]
    assert message in refusal["error"]
    assert good["ok"]
    assert shared_simulated_rig.control("status") == before


def test_operator_mounts_by_hand(shared_simulated_rig):
    control = shared_simulated_rig.control
    assert control("status")["sample"] == "none"
    control("mount", sample="charuco", pose=3)
    control("mount", laser_elevation_deg=50)
    status = control("status")
    control("mount", sample="none", pose=0, laser_elevation_deg=35)
    assert (status["sample"], status["pose"], status["laser_elevation_deg"]) == ("charuco", 3, 50.0)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_signal_ends_it_and_takes_the_wires_away(start_simulators, number):
    rig = start_simulators()
    rig.process.send_signal(number)
    assert rig.process.wait(timeout=20) == 0
    assert not (rig.state / "bus").is_symlink()


def test_end_of_its_standard_input_ends_it(start_simulators):
    rig = start_simulators()
    assert rig.end() == 0
    assert not (rig.state / "tower").is_symlink()


def test_a_file_as_standard_input_is_no_parent(tmp_path):
    """Started by an init system or with /dev/null it runs until it is told to end."""
    command = [sys.executable, "-m", "simulators", "--state", str(tmp_path / "rig")]
    with subprocess.Popen(command, cwd=ROOT, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout.readline().startswith("ready ")
            with pytest.raises(subprocess.TimeoutExpired):
                process.wait(timeout=0.3)
        finally:
            process.terminate()
        assert process.wait(timeout=20) == 0


def test_unusable_start_says_why(tmp_path):
    faults = tmp_path / "faults.toml"
    faults.write_text('[[fault]]\ndevice = "oven"\nkind = "drop"\n')
    command = [sys.executable, "-m", "simulators", "--state", str(tmp_path / "rig"), "--faults", str(faults)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1
    assert "oven" in done.stderr
    assert "Traceback" not in done.stderr


def test_fault_schedule_from_the_command_line(start_simulators, tmp_path):
    path = tmp_path / "faults.toml"
    path.write_text('[[fault]]\ndevice = "arm"\nkind = "nak"\nat_message = 2\n')
    rig = start_simulators("--faults", str(path))
    with serial.Serial(str(rig.state / "bus"), 9600, timeout=5) as port:
        statuses = []
        for _ in range(3):
            port.write(GET_POSITION)
            statuses.append(port.read(9)[2])
    assert statuses == [100, 4, 100]
    assert rig.control("faults")["faults"][0]["struck"] == 1


def test_unplugged_adapter_is_gone_and_comes_back(shared_simulated_rig):
    shared_simulated_rig.control("fault", device="bus", kind="unplug", seconds=2.0)
    port = os.open(shared_simulated_rig.state / "bus", os.O_RDWR | os.O_NOCTTY)
    try:
        os.write(port, GET_POSITION)
        shared_simulated_rig.control("now")
        with pytest.raises(OSError, match="Input/output error"):
            os.write(port, GET_POSITION)
    finally:
        os.close(port)
    assert not (shared_simulated_rig.state / "bus").exists()
    shared_simulated_rig.control("advance", seconds=2.1)
    with serial.Serial(str(shared_simulated_rig.state / "bus"), 9600, timeout=5) as again:
        again.write(GET_POSITION)
        assert len(again.read(9)) == 9
    shared_simulated_rig.control("clear_faults")


def test_unplugged_camera_hangs_up_and_comes_back(shared_simulated_rig):
    address = shared_simulated_rig.camera_address("cam0")
    host = PtpHost(address)
    shared_simulated_rig.control("fault", device="cam0", kind="unplug", seconds=2.0)
    with pytest.raises((AssertionError, OSError)):
        host.operate(0x1001)
    host.close()
    with pytest.raises(ConnectionRefusedError):
        PtpHost(address)
    shared_simulated_rig.control("advance", seconds=2.1)
    PtpHost(address).close()
    shared_simulated_rig.control("clear_faults")


def test_same_seed_same_bits_whatever_came_before(start_simulators, shared_simulated_rig, tmp_path):
    """Two runs that reach the same state on different ways, at different times, see the same noise in it."""
    first, second = start_simulators("--seed", "3"), start_simulators("--seed", "3")
    other = shared_simulated_rig.control("truth", what="cameras")["cameras"]
    assert first.control("truth", what="cameras")["cameras"] != other, "another seed is another rig"
    frames = []
    for rig in (first, second):
        rig.control("mount", sample="white")
        light(rig, [0, 0, 0, 0, 255])
        if rig is second:
            rig.control("advance", seconds=12.3)
            photograph(rig, "cam1", ticks=77)
        frames.append(photograph(rig, "cam4"))
    again = photograph(first, "cam4")
    one, two = (pixels(frame, tmp_path) for frame in frames)
    assert (one == two).all()
    assert (one != pixels(again, tmp_path)).any(), "a second exposure has noise of its own"


def test_exposures_are_noted_beside_the_session(simulated_rig):
    simulated_rig.control("mount", sample="white")
    light(simulated_rig, [255])
    photograph(simulated_rig, "cam3")
    (line,) = (simulated_rig.state / "truth" / "frames.jsonl").read_text().splitlines()
    note = json.loads(line)
    assert (note["camera"], note["sample"], note["lamps"], note["exposure_s"]) == (
        "cam3",
        "white",
        {"lamp0": 1.0},
        0.02,
    )
