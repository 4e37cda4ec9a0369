import json

import pytest

from rig.drivers.clock import Deadline, MonotonicClock, SimulatedClock
from rig.errors import ConnectError, TransportError


@pytest.fixture
def control_port(tcp_peer):
    """A control port that counts its advances."""
    requests = []

    def serve(connection):
        now = 0.0
        for line in connection.makefile("rb"):
            request = json.loads(line)
            requests.append(request)
            now += request.get("seconds", 0.0)
            fails = request.get("seconds") == 13
            reply = {"ok": False, "error": "no"} if fails else {"ok": True, "time_s": now}
            connection.sendall(json.dumps(reply).encode() + b"\n")

    return tcp_peer(serve), requests


def test_the_simulated_clock_moves_by_sleeping_and_not_otherwise(control_port):
    peer, requests = control_port
    clock = SimulatedClock(peer.address)
    clock.sleep(1.5)
    assert clock.now_s() == 1.5
    clock.has_waited(0.25)
    clock.sleep(0.0)
    assert clock.now_s() == 1.75
    assert [request["op"] for request in requests] == ["advance", "now", "advance", "now"]
    clock.close()
    clock.close()


def test_simulators_that_end_are_a_transport_error(control_port):
    peer, _ = control_port
    clock = SimulatedClock(peer.address)
    peer.hang_up()
    with pytest.raises(TransportError, match="are gone"):
        clock.sleep(1.0)
    clock.close()


class Interrupted:
    """A stream whose reader is interrupted when it waits for the reply, as by Ctrl-C."""

    def __init__(self, stream):
        self._stream = stream

    def readline(self):
        raise KeyboardInterrupt

    def __getattr__(self, name):
        return getattr(self._stream, name)


def test_an_interrupted_sleep_does_not_shift_all_the_following_replies(control_port):
    peer, _ = control_port
    clock = SimulatedClock(peer.address)
    clock._stream = Interrupted(clock._stream)
    with pytest.raises(KeyboardInterrupt):
        clock.sleep(100.0)
    clock.sleep(2.0)
    assert clock.now_s() == 2.0, "this control port counts each connection's time by itself"
    clock.close()


def test_a_refusal_of_the_simulators_is_told(control_port):
    peer, _ = control_port
    clock = SimulatedClock(peer.address)
    with pytest.raises(TransportError, match=r"refuse .*no"):
        clock.sleep(13)
    clock.close()


@pytest.mark.parametrize("address", ["127.0.0.1:1", "nowhere"])
def test_simulators_that_do_not_run_are_a_connect_error(address):
    with pytest.raises(ConnectError, match="Are they running"):
        SimulatedClock(address)


def test_the_wall_clock_never_goes_back_and_sleeps_at_least_as_long_as_asked():
    clock = MonotonicClock()
    before = clock.now_s()
    clock.sleep(0.01)
    clock.sleep(-1.0)
    clock.has_waited(5.0)
    assert 0.01 <= clock.now_s() - before < 5.0


def test_a_deadline_ends_at_zero():
    assert Deadline(0.0).left_s() == 0.0
    assert 0.0 < Deadline(60.0).left_s() <= 60.0
