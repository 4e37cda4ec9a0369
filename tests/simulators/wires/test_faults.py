import pytest

from simulators.faults import FaultError, FaultSchedule, Occasion
from simulators.line import corrupted

MESSAGE = Occasion.MESSAGE
DEVICES = {
    Occasion.MESSAGE: ("bus", "turntable", "cam0"),
    Occasion.FRAME: ("cam0", "cam1"),
    Occasion.MOVE: ("turntable",),
    Occasion.LAMP: ("lamp0",),
}


@pytest.fixture
def schedule():
    return FaultSchedule(1, DEVICES)


def kinds(schedule, n, devices=("bus",), occasion=MESSAGE):
    struck = (schedule.strike(devices, occasion, 0.1 * i) for i in range(1, n + 1))
    return [fault.kind if fault else None for fault in struck]


def test_next_occasion_by_default(schedule):
    schedule.add({"device": "bus", "kind": "drop"})
    assert kinds(schedule, 3) == ["drop", None, None]


def test_message_number_time_and_count(schedule):
    schedule.add({"device": "bus", "kind": "drop", "at_message": 3, "count": 2})
    schedule.add({"device": "bus", "kind": "nak", "at_time_s": 0.6})
    assert kinds(schedule, 7) == [None, None, "drop", "drop", None, "nak", None]


def test_devices_and_occasions_are_kept_apart(schedule):
    schedule.add({"device": "turntable", "kind": "corrupt"})
    schedule.add({"device": "turntable", "kind": "stall"})
    assert kinds(schedule, 1) == [None]
    assert kinds(schedule, 1, ("bus", "arm")) == [None]
    assert kinds(schedule, 2, ("bus", "turntable")) == ["corrupt", None]
    assert kinds(schedule, 1, ("turntable",), Occasion.MOVE) == ["stall"]
    assert schedule.seen()["bus"] == {"message": 4}


def test_probability_is_seeded(schedule):
    def run(seed):
        schedule = FaultSchedule(seed, DEVICES)
        schedule.add({"device": "bus", "kind": "drop", "count": 1000, "probability": 0.3})
        return kinds(schedule, 300)

    assert run(4) == run(4) != run(5)
    # A binomial of 300 throws has a standard deviation of 8.
    assert 90 - 40 < run(4).count("drop") < 90 + 40


def test_what_struck_is_listed_and_mended(schedule):
    schedule.add({"device": "bus", "kind": "drop", "count": 5})
    kinds(schedule, 2)
    assert schedule.listed()[0]["struck"] == 2
    schedule.clear()
    assert schedule.listed() == []
    assert kinds(schedule, 1) == [None]


def test_schedule_from_a_file(schedule, tmp_path):
    path = tmp_path / "faults.toml"
    path.write_text('[[fault]]\ndevice = "bus"\nkind = "delay"\nseconds = 0.5\nat_message = 2\n')
    schedule.load(path)
    assert kinds(schedule, 2) == [None, "delay"]


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"device": "bus"}, "kind: Field required"),
        ({"device": "bus", "kind": "explode"}, "unknown fault kind 'explode'"),
        ({"device": "oven", "kind": "drop"}, "no drop of 'oven'"),
        ({"device": "lamp0", "kind": "stall"}, "no stall of 'lamp0': one of turntable"),
        ({"device": "bus", "kind": "drop", "colour": 1}, "colour"),
        ({"device": "bus", "kind": "drop", "count": 0}, "count"),
        ({"device": "cam0", "kind": "wrong_camera"}, "needs 'other'"),
        ({"device": "bus", "kind": "drop", "at_message": "soon"}, "at_message"),
    ],
)
def test_impossible_faults_are_refused(schedule, entry, message):
    with pytest.raises(FaultError, match=message):
        schedule.add(entry)
    assert schedule.listed() == []


@pytest.mark.parametrize("text", ["[[fault]\n", "fault = 3\n", '[[fault]]\ndevice = "bus"\n'])
def test_unusable_files_are_refused(schedule, tmp_path, text):
    path = tmp_path / "faults.toml"
    path.write_text(text)
    with pytest.raises(FaultError):
        schedule.load(path)
    with pytest.raises(FaultError, match="nowhere"):
        schedule.load(tmp_path / "nowhere.toml")


class TestLine:
    """What a fault does to a reply; the wires are tested with their devices."""

    def exchange(self, bus, reply):
        bus.line.reply(reply, bus.line.request(9))
        return bus.take()

    @pytest.fixture
    def bus(self, wire):
        return wire("bus")

    def test_stale_reply_comes_before_the_next_one(self, bus, faults):
        faults.add({"device": "bus", "kind": "stale"})
        assert [self.exchange(bus, b"one"), self.exchange(bus, b"two"), self.exchange(bus, b"three")] == [
            b"", b"onetwo", b"three"
        ]  # fmt: skip

    def test_delayed_reply_comes_in_its_time(self, bus, faults, clock):
        faults.add({"device": "bus", "kind": "delay", "seconds": 0.7})
        assert self.exchange(bus, b"late") == b""
        clock.advance(0.69)
        assert bus.take() == b""
        clock.advance(0.02)
        assert bus.take() == b"late"

    @pytest.mark.parametrize(
        ("kind", "result"),
        [("drop", b""), ("truncate", b"1234"), ("duplicate", b"1234567812345678"), ("corrupt", corrupted(b"12345678"))],
    )
    def test_replies_are_struck_once(self, bus, faults, kind, result):
        faults.add({"device": "bus", "kind": kind})
        assert self.exchange(bus, b"12345678") == result
        assert self.exchange(bus, b"12345678") == b"12345678"

    def test_corruption_changes_one_byte(self):
        assert sum(a != b for a, b in zip(corrupted(b"12345678"), b"12345678", strict=True)) == 1

    def test_unplugging(self, bus, faults):
        faults.add({"device": "bus", "kind": "unplug", "seconds": 3.0})
        assert self.exchange(bus, b"gone") == b""
        assert bus.unplugged == [3.0]
