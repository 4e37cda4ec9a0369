import itertools
import struct

import pytest

from simulators.camera import Camera, phone_make
from simulators.line import Line
from simulators.phone import SPEEDS, build_phone
from simulators.ptp_ip import Responder
from simulators.shutter import READOUT_S, Shutter

OK, GENERAL_ERROR, NO_SESSION, UNSUPPORTED, NO_OBJECT, NO_PROPERTY = 0x2001, 0x2002, 0x2003, 0x2005, 0x2009, 0x200A
BUSY, BAD_FORMAT, BAD_VALUE, SESSION_OPEN = 0x2019, 0x201B, 0x201C, 0x201E
OBJECT_ADDED, CAPTURE_COMPLETE = 0x4002, 0x400D
EXPOSURE, MODE, NUMBER, INTERVAL = 0x500D, 0x5013, 0x5018, 0x5019
ALL = 0xFFFFFFFF


class Host:
    """One end of both connections: what is written to it can be taken as packets."""

    def __init__(self, responder):
        self.responder = responder
        self.sent = b""
        self.closed = False

    def write(self, data):
        self.sent += data

    def close(self):
        self.closed = True
        self.responder.lost(self)

    def take(self):
        packets = []
        while self.sent:
            length, kind = struct.unpack_from("<II", self.sent)
            packets.append((kind, self.sent[8:length]))
            self.sent = self.sent[length:]
        return packets


class Client:
    """A host with its session."""

    def __init__(self, responder, vectors):
        self.command, self.event = Host(responder), Host(responder)
        self._responder = responder
        self._transaction = 0
        responder.receive(self.command, vectors("ptp")["init_command_request"]["wire"])
        ((kind, body),) = self.command.take()
        assert kind == 2
        responder.receive(self.event, struct.pack("<II", 12, 3) + body[:4])
        assert self.event.take() == [(4, b"")]

    def operate(self, code, *parameters, data=None):
        """Response code, and data or response parameters."""
        transaction = self._transaction
        self._transaction += 1
        phase = 1 if data is None else 2
        body = struct.pack(f"<IHI{len(parameters)}I", phase, code, transaction, *parameters)
        packets = struct.pack("<II", len(body) + 8, 6) + body
        if data is not None:
            packets += struct.pack("<IIIQ", 20, 9, transaction, len(data))
            packets += struct.pack("<III", 12 + len(data), 12, transaction) + data
        self._responder.receive(self.command, packets)
        answer, came = b"", self.command.take()
        for kind, body in came:
            if kind in (10, 12):
                assert body[:4] == struct.pack("<I", transaction)
                answer += body[4:]
            elif kind == 7:
                code, echo = struct.unpack_from("<HI", body)
                assert echo == transaction
                return code, answer or struct.unpack_from(f"<{(len(body) - 6) // 4}I", body, 6)
        return None

    def set(self, prop, value):
        return self.operate(0x1016, prop, data=struct.pack("<I" if prop == EXPOSURE else "<H", value))[0]

    def events(self):
        """Codes and parameters of the events since."""
        read = [(struct.unpack_from("<HI", body)[0], body[6:]) for kind, body in self.event.take() if kind == 8]
        return [(code, *struct.unpack(f"<{len(rest) // 4}I", rest)) for code, rest in read]


@pytest.fixture
def cameras(world, darkroom, clock, faults):
    """Responders of all cameras by name."""

    def responder(layout):
        camera = Camera(layout, Shutter(layout, world, darkroom), clock.now_s)
        return Responder(camera, Line(layout.name, clock, faults, layout.megabytes_per_s * 1e6))

    return {name: responder(layout) for name, layout in world.layout.cameras.items()}


@pytest.fixture
def client(cameras, vectors):
    client = Client(cameras["cam2"], vectors)
    assert client.operate(0x1002, 1)[0] == OK
    return client


REQUESTS = [
    "get_device_info", "get_storage_ids", "get_object_handles", "get_storage_info", "get_property_desc_exposure",
    "initiate_capture", "close_session",
]  # fmt: skip


@pytest.mark.parametrize("name", REQUESTS)
def test_real_requests_are_answered(client, cameras, vectors, name):
    cameras["cam2"].receive(client.command, vectors("ptp")[name]["wire"])
    kind, body = client.command.take()[-1]
    assert kind == 7
    assert struct.unpack_from("<HI", body) == (OK, vectors("ptp")[name]["decoded"]["transaction"])


def test_real_property_write_with_its_data_phase(client, cameras, vectors):
    """The client of the vectors asks for ISO 200, which this camera does not have."""
    ptp = vectors("ptp")
    for name in ("set_property_value_iso", "start_data_iso", "end_data_iso"):
        cameras["cam2"].receive(client.command, ptp[name]["wire"])
    ((kind, body),) = client.command.take()
    assert (kind, struct.unpack_from("<H", body)[0]) == (7, BAD_VALUE)


def test_ping_is_answered(client, cameras, vectors):
    cameras["cam2"].receive(client.command, vectors("ptp")["ping"]["wire"])
    assert client.command.take() == [(14, b"")]


def test_property_descriptions_follow_the_standard(client, vectors):
    """As in the vector: u32, writable, a range of 0.1 ms to 60 s in steps of 0.1 ms."""
    wanted = vectors("ptp")["property_exposure"]["wire"]
    client.set(EXPOSURE, 50_000)
    description = client.operate(0x1014, EXPOSURE)[1]
    assert description[:5] == wanted[:5]
    assert description[9:] == wanted[9:]


def test_second_host_is_refused(client, cameras, vectors):
    second = Host(cameras["cam2"])
    cameras["cam2"].receive(second, vectors("ptp")["init_command_request"]["wire"])
    assert second.take() == [(5, vectors("ptp")["init_fail_busy"]["wire"][8:])]
    assert second.closed
    assert client.operate(0x1001)[0] == OK


def test_what_follows_a_refusal_is_not_obeyed(client, cameras, vectors):
    """The connection is closed: bytes that came in the same breath find nobody."""
    ptp, second = vectors("ptp"), Host(cameras["cam2"])
    cameras["cam2"].receive(second, ptp["init_command_request"]["wire"] + ptp["ping"]["wire"])
    assert [kind for kind, _ in second.take()] == [5]
    assert second.closed


def test_packets_in_single_bytes(cameras, vectors):
    host = Host(cameras["cam0"])
    for byte in vectors("ptp")["init_command_request"]["wire"]:
        cameras["cam0"].receive(host, bytes([byte]))
    assert [kind for kind, _ in host.take()] == [2]


def test_impossible_length_ends_the_connection(cameras, vectors):
    host = Host(cameras["cam0"])
    cameras["cam0"].receive(host, vectors("ptp")["length_below_header"]["wire"])
    assert host.closed


def test_session_rules(cameras, vectors):
    client = Client(cameras["cam1"], vectors)
    assert client.operate(0x1001)[0] == OK, "device info needs no session"
    assert client.operate(0x1007, ALL)[0] == NO_SESSION
    assert client.operate(0x1002, 1)[0] == OK
    assert client.operate(0x1002, 2)[0] == SESSION_OPEN
    assert client.operate(0x1003)[0] == OK
    assert client.operate(0x1004)[0] == NO_SESSION


def test_refusals(client):
    assert client.operate(0x9999)[0] == UNSUPPORTED
    assert client.operate(0x1009, 77)[0] == NO_OBJECT
    assert client.operate(0x1015, 0x5FFF)[0] == NO_PROPERTY
    assert client.set(EXPOSURE, 0) == BAD_VALUE
    assert client.operate(0x1016, EXPOSURE, data=b"\x01\x00")[0] == BAD_FORMAT
    assert client.operate(0x1016, 0x5001, data=b"\x01")[0] == 0x200F


def test_one_exposure(client, clock, darkroom):
    assert client.set(EXPOSURE, 5000) == OK
    start_s = clock.now_s()
    assert client.operate(0x100E, 0, 0)[0] == OK
    clock.advance(0.5 - 1e-3)
    assert darkroom.shots == []
    assert client.operate(0x100E, 0, 0)[0] == BUSY
    assert client.set(EXPOSURE, 1) == BUSY
    clock.advance(0.5)
    assert client.events() == [(OBJECT_ADDED, 1), (CAPTURE_COMPLETE,)]
    (shot,) = darkroom.shots
    assert shot["exposure_s"] == 0.5
    assert shot["serial"] == "VC-0002"
    assert shot["time_s"] == pytest.approx(start_s, abs=1e-3)
    assert client.operate(0x1006, ALL)[1] == (1,)
    info = client.operate(0x1008, 1)[1]
    data = client.operate(0x1009, 1)[1]
    assert struct.unpack_from("<I", info, 8)[0] == len(data)
    assert data == b"frame 1 of VC-0002" * 8
    assert client.operate(0x100B, 1)[0] == OK
    assert client.operate(0x1009, 1)[0] == NO_OBJECT


def test_download_time_is_charged(client, clock):
    client.operate(0x100E)
    clock.advance(1.0)
    before_s = clock.now_s()
    data = client.operate(0x1009, 1)[1]
    assert clock.now_s() - before_s == pytest.approx(len(data) / 20e6, rel=0.5)


def test_frame_shows_the_world_at_mid_exposure(client, clock, darkroom, world):
    """A turn at constant speed: the picture is taken where the axis is after half the exposure."""
    stage = world.stages["turntable"]
    stage.rotate(1600.0, 1e6)
    clock.advance(1.0)
    client.set(EXPOSURE, 10_000)
    start = stage.angle_rad()
    client.operate(0x100E)
    clock.advance(2.0)
    assert darkroom.shots[0]["pose"].turntable_rad - start == pytest.approx(0.1745 / 2, abs=1e-3)


def test_lamps_switched_off_after_the_middle_still_count(client, clock, darkroom, world):
    client.set(EXPOSURE, 10_000)
    world.lamps.universe = bytes([255] + [0] * 23)
    client.operate(0x100E)
    clock.advance(0.6)
    world.lamps.universe = bytes(24)
    clock.advance(1.0)
    assert darkroom.shots[0]["pose"].lamps == (("lamp0", 1.0),)


def burst(client, frames, interval_ms, exposure_ticks):
    for prop, value in ((EXPOSURE, exposure_ticks), (MODE, 2), (NUMBER, frames), (INTERVAL, interval_ms)):
        assert client.set(prop, value) == OK
    assert client.operate(0x100E)[0] == OK


def test_burst_keeps_its_beat_and_follows_the_laser(client, clock, darkroom, world):
    world.laser.on = True
    world.turn_laser(1, 7)
    clock.advance(1.0)
    burst(client, frames=20, interval_ms=133, exposure_ticks=300)
    clock.advance(3.0)
    starts = [shot["time_s"] for shot in darkroom.shots]
    assert len(starts) == 20
    assert all(b - a == pytest.approx(0.133) for a, b in itertools.pairwise(starts))
    sweeps = [shot["pose"].laser_sweep for shot in darkroom.shots]
    flat = [angle for sweep in sweeps for angle in sweep]
    assert flat == sorted(flat), "the fan goes on in every frame and between frames"
    within, between = sweeps[5][1] - sweeps[5][0], sweeps[6][0] - sweeps[5][1]
    assert within / between == pytest.approx(30 / 103, rel=0.1)
    assert client.events() == [*((OBJECT_ADDED, handle) for handle in range(1, 21)), (CAPTURE_COMPLETE,)]


def test_interval_shorter_than_the_exposure_waits_for_the_read_out(client, clock, darkroom):
    burst(client, frames=3, interval_ms=10, exposure_ticks=1000)
    clock.advance(1.0)
    starts = [shot["time_s"] for shot in darkroom.shots]
    assert starts[2] - starts[0] == pytest.approx(2 * (0.1 + READOUT_S))


@pytest.mark.parametrize("how", ["terminate", "close", "disconnect", "cancel"])
def test_burst_can_be_dropped(client, cameras, clock, darkroom, how):
    burst(client, frames=100, interval_ms=100, exposure_ticks=100)
    clock.advance(1.0)
    before = len(darkroom.shots)
    match how:
        case "terminate":
            assert client.operate(0x1018, 1)[0] == OK
        case "close":
            assert client.operate(0x1003)[0] == OK
        case "disconnect":
            cameras["cam2"].lost(client.command)
        case "cancel":
            cameras["cam2"].receive(client.command, struct.pack("<III", 12, 11, 5))
    clock.advance(10.0)
    assert 0 < before == len(darkroom.shots)


def test_memory_outlives_the_session(client, cameras, clock, vectors):
    client.operate(0x100E)
    clock.advance(1.0)
    cameras["cam2"].lost(client.command)
    again = Client(cameras["cam2"], vectors)
    again.operate(0x1002, 1)
    assert again.operate(0x1006, ALL)[1] == (1,)
    assert again.operate(0x100B, ALL)[0] == OK
    assert again.operate(0x1007, ALL)[1] == struct.pack("<I", 0)


def test_all_cameras_expose_at_once(cameras, clock, darkroom, vectors):
    clients = [Client(responder, vectors) for responder in cameras.values()]
    for client in clients:
        client.operate(0x1002, 1)
    start_s = clock.now_s()
    for client in clients:
        client.operate(0x100E)
    clock.advance(0.1)
    assert {shot["serial"] for shot in darkroom.shots} == {f"VC-{i:04d}" for i in range(8)} | {"DS-0001"}
    assert max(shot["time_s"] for shot in darkroom.shots) - start_s < 1e-3


def test_keys_tell_repeated_exposures_apart_and_nothing_else(client, clock, darkroom, world):
    world.lamps.universe = bytes([255] + [0] * 23)
    for level in (255, 255, 128, 255):
        world.lamps.universe = bytes([level] + [0] * 23)
        client.operate(0x100E)
        clock.advance(1.0)
    first, second, dimmed, third = (shot["key"] for shot in darkroom.shots)
    assert first[:-1] == second[:-1] == third[:-1] != dimmed[:-1]
    assert [key[-1] for key in (first, second, dimmed, third)] == [0, 1, 0, 2]


class TestFaults:
    def shoot(self, client, clock):
        client.operate(0x100E)
        clock.advance(1.0)
        return client.events()

    def test_no_frame(self, client, clock, faults, darkroom):
        faults.add({"device": "cam2", "kind": "no_frame"})
        assert self.shoot(client, clock) == []
        assert self.shoot(client, clock) == [(OBJECT_ADDED, 1), (CAPTURE_COMPLETE,)]

    def test_wrong_camera(self, client, clock, faults, darkroom):
        faults.add({"device": "cam2", "kind": "wrong_camera", "other": "cam5"})
        self.shoot(client, clock)
        assert (darkroom.shots[0]["camera"], darkroom.shots[0]["serial"]) == ("cam5", "VC-0005")

    def test_frozen_frame_is_the_one_before(self, client, clock, faults):
        self.shoot(client, clock)
        faults.add({"device": "cam2", "kind": "frozen"})
        self.shoot(client, clock)
        self.shoot(client, clock)
        first, second, third = (client.operate(0x1009, handle)[1] for handle in (1, 2, 3))
        assert first == second != third

    def test_dark_frame(self, client, clock, faults, darkroom, world):
        world.lamps.universe = bytes([255] * 24)
        faults.add({"device": "cam2", "kind": "dark"})
        self.shoot(client, clock)
        self.shoot(client, clock)
        assert [len(shot["pose"].lamps) for shot in darkroom.shots] == [0, 9]

    @pytest.mark.parametrize(("kind", "code"), [("nak", GENERAL_ERROR), ("busy", BUSY)])
    def test_refusal(self, client, clock, faults, darkroom, kind, code):
        faults.add({"device": "cam2", "kind": kind})
        assert client.operate(0x100E)[0] == code
        clock.advance(1.0)
        assert darkroom.shots == []

    def test_truncated_and_corrupt_objects_are_well_framed(self, client, clock, faults):
        self.shoot(client, clock)
        whole = client.operate(0x1009, 1)[1]
        faults.add({"device": "cam2", "kind": "truncate"})
        assert client.operate(0x1009, 1) == (OK, whole[: len(whole) // 2])
        faults.add({"device": "cam2", "kind": "corrupt"})
        code, data = client.operate(0x1009, 1)
        assert code == OK
        assert sum(a != b for a, b in zip(data, whole, strict=True)) == 1

    def test_lost_response(self, client, clock, faults, darkroom):
        faults.add({"device": "cam2", "kind": "drop"})
        assert client.operate(0x100E) is None
        clock.advance(1.0)
        assert len(darkroom.shots) == 1, "obeyed all the same"


@pytest.fixture
def phone(world, darkroom, clock, faults, vectors):
    layout = build_phone(1, "small")
    camera = Camera(layout, Shutter(layout, world, darkroom), clock.now_s, phone_make(SPEEDS))
    client = Client(Responder(camera, Line(layout.name, clock, faults, 1e12)), vectors)
    assert client.operate(0x1002, 1)[0] == OK
    return client


def test_the_phone_is_told_a_shutter_speed_and_a_format(phone, clock, darkroom, vectors):
    """As of the vectors: 1/32000 s, and one JPEG, then one DNG; what it does not list is refused."""
    speed = vectors("ptp")["value_shutter_speed"]["wire"]
    assert phone.operate(0x1016, 0xD00F, data=speed)[0] == OK
    assert phone.operate(0x1016, 0xD00F, data=struct.pack("<II", 1, 31_999))[0] == BAD_VALUE
    assert phone.operate(0x1014, 0x500D)[0] == NO_PROPERTY
    for form, bits, ending in ((0x3801, 8, "JPG"), (0x3811, 16, "DNG"), (0, 8, "JPG")):
        assert phone.operate(0x100E, 0, form)[0] == OK
        clock.advance(0.1)
        (code, handle), _ = phone.events()
        assert code == OBJECT_ADDED
        info = phone.operate(0x1008, handle)[1]
        assert struct.unpack_from("<H", info, 4)[0] == (form or 0x3801)
        assert struct.unpack_from("<I", info, 34)[0] == bits
        assert f"{handle:05d}.{ending}".encode("utf-16-le") in info
        assert phone.operate(0x1009, handle)[1].startswith(b"jpeg ") == (ending == "JPG")
    assert [shot["exposure_s"] for shot in darkroom.shots] == [1 / 32_000] * 3
    assert len({shot["key"] for shot in darkroom.shots}) == 3
    assert phone.operate(0x1007, ALL, 0x3811, 0)[1][:4] == struct.pack("<I", 1)
    assert phone.operate(0x100E, 0, 0x3808)[0] == 0x200B, "no such format"


def test_phone_property_description_has_the_form_of_the_vector(phone, vectors):
    told, vector = phone.operate(0x1014, 0xD00F)[1], vectors("ptp")["property_shutter_speed"]["wire"]
    assert told[:5] == vector[:5]
    assert told[21] == vector[21] == 2
    (count,) = struct.unpack_from("<H", told, 22)
    assert struct.unpack_from("<II", told, 24) == (1, 32_000)
    assert len(told) == 24 + 8 * count
