import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from rig.drivers.link import Echo, Link
from rig.drivers.transport import SerialTransport
from rig.errors import FrameError, ReadTimeoutError, TransportError
from tests.rig.drivers.peers import cut_fixed


class Lines:
    """Frames that end with a newline; `!` makes the stream invalid."""

    def __init__(self):
        self._buffer = b""

    def feed(self, data):
        if b"!" in data:
            raise FrameError("out of step")
        *frames, self._buffer = (self._buffer + data).split(b"\n")
        return frames

    def clear(self):
        self._buffer = b""


@pytest.fixture
def wire(pty_peer, clock):
    """A link and a function that scripts the answers to the requests to come."""
    answers = []
    peer = pty_peer(cut_fixed(2), lambda _: answers.pop(0) if answers else b"")
    link = Link("device", SerialTransport("device", peer.port, baudrate=9600), Lines(), clock)
    link.open()
    yield link, peer, answers
    link.close()


def ask(link, accept=lambda _: True, attempts=1):
    return link.request(b"?\n", accept, what="a question", timeout_s=0.1, attempts=attempts)


def test_the_first_accepted_frame_is_the_reply(wire):
    link, _, answers = wire
    answers.append(b"noise\nlate\nyes\n")
    assert ask(link, lambda frame: frame == b"yes") == b"yes"


def test_what_came_before_the_request_never_answers_it(wire):
    link, peer, answers = wire
    answers += [b"one\ntwo\n", b"three\n"]
    assert ask(link) == b"one"
    peer.send(b"stale\nhalf a fra")
    assert ask(link) == b"three"


def test_silence_is_a_timeout_with_the_bytes_both_ways(wire, clock):
    link, _, _ = wire
    with pytest.raises(ReadTimeoutError, match=r"device: no reply to a question within 0\.1 s.*> 3f 0a"):
        ask(link)
    assert clock.now_s() >= 0.1, "the rig's time follows the time spent waiting"


def test_rubbish_is_a_frame_error_with_the_bytes(wire):
    link, _, answers = wire
    answers.append(b"\xde\xad")
    with pytest.raises(FrameError, match=r"what came is no reply to a question.*< de ad"):
        ask(link)


def test_requests_are_repeated_as_often_as_allowed_and_not_once_more(wire):
    link, peer, answers = wire
    answers += [b"", b"rubbish", b"yes\n"]
    assert ask(link, attempts=3) == b"yes"
    assert len(peer.requests) == 3
    with pytest.raises(ReadTimeoutError):
        ask(link, attempts=2)
    assert len(peer.requests) == 5


def test_a_stream_out_of_step_closes_the_wire(wire):
    link, _, answers = wire
    answers.append(b"!")
    with pytest.raises(TransportError, match="out of step"):
        ask(link)
    assert not link.is_open


def test_a_lost_wire_is_opened_anew_by_the_next_request(wire):
    link, peer, answers = wire
    peer.unplug()
    with pytest.raises(TransportError, match="lost"):
        ask(link, attempts=3)
    peer.plug()
    answers.append(b"back\n")
    assert ask(link) == b"back"


def test_poll_returns_what_has_come_and_does_not_wait(wire):
    link, peer, _ = wire
    assert link.poll() == []
    peer.send(b"a\nb\n")
    assert link.receive(lambda frame: frame == b"b", what="b", timeout_s=1.0) == b"b"
    assert link.poll() == []


@given(st.binary(max_size=12), st.binary(max_size=12), st.booleans(), st.data())
@settings(max_examples=50, deadline=None)
def test_an_echo_is_stripped_and_a_reply_without_one_is_left_alone(request_bytes, reply, echoes, data):
    """In any chunking. A reply that begins like the request could be its echo, and is left out here."""
    assume(echoes or not (reply.startswith(request_bytes) or request_bytes.startswith(reply)))
    stream = (request_bytes if echoes else b"") + reply
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=4)))
    echo = Echo()
    echo.sent(request_bytes)
    parts = [stream[a:b] for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True)]
    assert b"".join(map(echo.strip, parts)) == reply
