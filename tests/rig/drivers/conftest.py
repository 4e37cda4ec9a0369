"""Wires with scripted devices, and time-outs short enough for tests of silence."""

from collections.abc import Callable

import pytest

from rig.drivers import bus, camera, lamps, laser_unit, ptp_connection
from tests.rig.drivers.peers import PtyPeer, TcpPeer, VirtualClock


@pytest.fixture(autouse=True)
def short_timeouts(monkeypatch):
    """A peer in the same process answers within a millisecond or not at all."""
    monkeypatch.setattr(bus, "_REPLY_TIMEOUT_S", 0.15)
    monkeypatch.setattr(lamps, "_REPLY_TIMEOUT_S", 0.15)
    monkeypatch.setattr(laser_unit, "_REPLY_TIMEOUT_S", 0.15)
    monkeypatch.setattr(ptp_connection, "_REPLY_TIMEOUT_S", 0.3)
    monkeypatch.setattr(ptp_connection, "_QUIET_S", 0.1)
    monkeypatch.setattr(ptp_connection, "_INIT_TIMEOUT_S", 0.3)
    monkeypatch.setattr(camera, "_DOWNLOAD_TIMEOUT_S", 0.3)


@pytest.fixture
def clock():
    return VirtualClock()


@pytest.fixture
def pty_peer(tmp_path) -> Callable[..., PtyPeer]:
    peers = []

    def make(cut, answer, *, echo=False):
        peers.append(PtyPeer(tmp_path / f"port{len(peers)}", cut, answer, echo=echo))
        return peers[-1]

    yield make
    for peer in peers:
        peer.unplug()


@pytest.fixture
def tcp_peer() -> Callable[..., TcpPeer]:
    peers = []

    def make(serve):
        peers.append(TcpPeer(serve))
        return peers[-1]

    yield make
    for peer in peers:
        peer.close()
