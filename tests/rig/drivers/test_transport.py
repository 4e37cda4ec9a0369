import pytest

from rig.drivers.transport import SerialTransport, SocketTransport
from rig.errors import ConnectError, ReadTimeoutError, TransportError
from tests.rig.drivers.peers import cut_fixed


def reverse(request):
    return request[::-1]


@pytest.fixture
def serial_port(pty_peer):
    peer = pty_peer(cut_fixed(3), reverse)
    transport = SerialTransport("lamps", peer.port, baudrate=9600)
    transport.open()
    yield transport, peer
    transport.close()


@pytest.fixture
def stream(tcp_peer):
    def serve(connection):
        while data := connection.recv(100):
            connection.sendall(data[::-1])

    peer = tcp_peer(serve)
    transport = SocketTransport("cam0", peer.address)
    transport.open()
    yield transport, peer
    transport.close()


@pytest.mark.parametrize("wire", ["serial_port", "stream"])
def test_what_is_written_arrives_and_what_is_answered_comes_back(wire, request):
    transport, _ = request.getfixturevalue(wire)
    transport.write(b"abc")
    data = b""
    while len(data) < 3:
        data += transport.read(2.0)
    assert data == b"cba"
    assert transport.drain() == b""


@pytest.mark.parametrize("wire", ["serial_port", "stream"])
def test_silence_is_a_read_timeout(wire, request):
    transport, _ = request.getfixturevalue(wire)
    with pytest.raises(ReadTimeoutError, match="no byte from"):
        transport.read(0.02)
    assert transport.is_open


def test_an_unplugged_adapter_is_a_transport_error_that_says_what_to_do(serial_port):
    transport, peer = serial_port
    peer.unplug()
    with pytest.raises(TransportError, match=r"lamps: lost .*Check the cable") as caught:
        transport.read(2.0)
    assert not isinstance(caught.value, ReadTimeoutError)
    assert not transport.is_open
    with pytest.raises(TransportError, match="not open"):
        transport.write(b"abc")


def test_writing_to_an_unplugged_adapter_is_a_transport_error(serial_port):
    transport, peer = serial_port
    peer.unplug()
    with pytest.raises(TransportError, match="Check the cable"):
        transport.write(b"abc")


def test_an_adapter_that_was_plugged_in_again_works_again(serial_port):
    transport, peer = serial_port
    peer.unplug()
    with pytest.raises(TransportError):
        transport.read(2.0)
    peer.plug()
    transport.open()
    transport.write(b"abc")
    assert transport.read(2.0)[:1] == b"c"


def test_a_camera_that_hangs_up_is_a_transport_error(stream):
    transport, peer = stream
    peer.hang_up()
    with pytest.raises(TransportError, match="hung up"):
        transport.read(2.0)
    with pytest.raises(TransportError, match="not connected"):
        transport.write(b"abc")


def test_a_port_that_is_not_there_is_named(tmp_path):
    port = tmp_path / "nothing"
    with pytest.raises(ConnectError, match=rf"bus: cannot open {port}.*plugged in"):
        SerialTransport("bus", str(port), baudrate=9600).open()


@pytest.mark.parametrize("address", ["127.0.0.1:1", "no port", "127.0.0.1:http"])
def test_an_address_that_does_not_answer_is_named(address):
    with pytest.raises(ConnectError, match=rf"cam0: cannot connect to {address}.*host:port"):
        SocketTransport("cam0", address).open()


def test_a_port_serves_one_owner(serial_port):
    _, peer = serial_port
    with pytest.raises(ConnectError, match="free"):
        SerialTransport("other", peer.port, baudrate=9600).open()


def test_a_port_with_parity_opens_again_also_where_it_is_a_pseudo_terminal(pty_peer):
    """The C library refuses to set a parity that the pseudo-terminal silently drops, from the second opening on."""
    peer = pty_peer(cut_fixed(3), reverse)
    for _ in range(2):
        transport = SerialTransport("laser", peer.port, baudrate=2400, parity="O")
        transport.open()
        transport.write(b"abc")
        assert transport.read(2.0)[:1] == b"c"
        transport.close()


def test_any_url_of_pyserial_will_do(tcp_peer):
    peer = tcp_peer(lambda connection: connection.sendall(connection.recv(100)[::-1]))
    transport = SerialTransport("bus", f"socket://{peer.address}", baudrate=9600)
    transport.open()
    transport.write(b"abc")
    data = b""
    while len(data) < 3:
        data += transport.read(2.0)
    transport.close()
    assert data == b"cba"
