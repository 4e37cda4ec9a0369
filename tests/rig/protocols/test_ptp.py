import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.errors import FrameError
from rig.protocols import ptp, ptp_ip

U16, U32, U64 = (st.integers(0, 2**bits - 1) for bits in (16, 32, 64))
NAME = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=20)
PARAMETERS = st.lists(U32, max_size=5).map(tuple)
GUID = st.binary(min_size=16, max_size=16)
PACKETS = st.one_of(
    st.builds(ptp_ip.InitCommandRequest, GUID, NAME),
    st.builds(ptp_ip.InitCommandAck, U32, GUID, NAME),
    st.builds(ptp_ip.InitEventRequest, U32),
    st.builds(ptp_ip.InitFail, U32),
    st.builds(ptp_ip.OperationRequest, U32, U16, U32, PARAMETERS),
    st.builds(ptp_ip.OperationResponse, U16, U32, PARAMETERS),
    st.builds(ptp_ip.EventPacket, U16, U32, PARAMETERS),
    st.builds(ptp_ip.StartData, U32, U64),
    st.builds(ptp_ip.Data, U32, st.binary(max_size=50)),
    st.builds(ptp_ip.EndData, U32, st.binary(max_size=50)),
    st.builds(ptp_ip.Cancel, U32),
    st.sampled_from([ptp_ip.InitEventAck(), ptp_ip.Ping(), ptp_ip.Pong()]),
)


def packet_of(decoded):
    """The packet that a vector's decoded values name; PTP/IP's own type numbers choose the class."""
    values = dict(decoded)
    kinds = {
        1: ptp_ip.InitCommandRequest,
        2: ptp_ip.InitCommandAck,
        3: ptp_ip.InitEventRequest,
        4: ptp_ip.InitEventAck,
        5: ptp_ip.InitFail,
        6: ptp_ip.OperationRequest,
        7: ptp_ip.OperationResponse,
        8: ptp_ip.EventPacket,
        9: ptp_ip.StartData,
        10: ptp_ip.Data,
        11: ptp_ip.Cancel,
        12: ptp_ip.EndData,
        13: ptp_ip.Ping,
        14: ptp_ip.Pong,
    }
    kind = kinds[values.pop("type")]
    for key, convert in (("guid", bytes.fromhex), ("payload", bytes.fromhex), ("parameters", tuple)):
        if key in values:
            values[key] = convert(values[key])
    return kind(**values)


@pytest.mark.vectors("ptp", "packet")
def test_packet_vectors_hold_both_ways(vector):
    packet = packet_of(vector["decoded"])
    assert ptp_ip.encode(packet) == vector["wire"]
    assert ptp_ip.decode(vector["wire"]) == packet


@pytest.mark.vectors("ptp", "packet")
def test_malformed_packets_are_refused(malformed):
    with pytest.raises(FrameError):
        ptp_ip.decode(malformed["wire"])
    with pytest.raises(FrameError, match="out of step"):
        ptp_ip.PacketReader().feed(malformed["wire"])


@pytest.mark.vectors("ptp", "device_info")
def test_device_info_vector_holds_both_ways(vector):
    info = ptp.decode_device_info(vector["wire"])
    assert ptp.encode_device_info(info) == vector["wire"]
    for key, value in vector["decoded"].items():
        assert getattr(info, key) == (tuple(value) if isinstance(value, list) else value)


@pytest.mark.vectors("ptp", "device_info")
def test_cut_device_info_is_refused(malformed):
    with pytest.raises(FrameError):
        ptp.decode_device_info(malformed["wire"])


@pytest.mark.vectors("ptp", "object_info")
def test_object_info_vector_holds_both_ways(vector):
    info = ptp.ObjectInfo(**vector["decoded"])
    assert ptp.decode_object_info(vector["wire"]) == info
    assert ptp.encode_object_info(info) == vector["wire"]


@pytest.mark.vectors("ptp", "u32_array")
def test_array_vectors_hold_both_ways(vector):
    values = tuple(vector["decoded"]["values"])
    assert ptp.decode_u32_array(vector["wire"]) == values
    assert ptp.encode_u32_array(values) == vector["wire"]


@pytest.mark.vectors("ptp", "property_desc")
def test_property_vectors_hold_both_ways(vector):
    decoded = vector["decoded"]
    desc = ptp.decode_property_desc(vector["wire"])
    assert (desc.code, desc.data_type, desc.writable) == (
        decoded["code"],
        decoded["data_type"],
        bool(decoded["writable"]),
    )
    assert (desc.default, desc.current) == (decoded["default"], decoded["current"])
    limits = (decoded["minimum"], decoded["maximum"], decoded["step"]) if decoded["form"] == 1 else None
    assert desc.range == limits
    assert desc.values == tuple(decoded.get("values", ()))
    assert ptp.encode_property_desc(desc) == vector["wire"]


@pytest.mark.vectors("ptp", "property_value")
def test_value_vectors_hold_both_ways(vector):
    decoded = vector["decoded"]
    assert ptp.PROPERTY_TYPES[ptp.Property(decoded["code"])] == decoded["data_type"]
    assert ptp.encode_value(decoded["data_type"], decoded["value"]) == vector["wire"]
    assert ptp.decode_value(decoded["data_type"], vector["wire"]) == decoded["value"]


@given(PACKETS)
@settings(max_examples=50, deadline=None)
def test_packets_lose_nothing(packet):
    assert ptp_ip.decode(ptp_ip.encode(packet)) == packet


@given(st.lists(PACKETS, max_size=4), st.data())
@settings(max_examples=50, deadline=None)
def test_any_chunking_gives_the_same_packets(packets, data):
    stream = b"".join(map(ptp_ip.encode, packets))
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=8)))
    reader = ptp_ip.PacketReader()
    parts = [stream[a:b] for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True)]
    assert [packet for part in parts for packet in reader.feed(part)] == packets


@given(PACKETS, st.integers(1, 100))
@settings(max_examples=50, deadline=None)
def test_a_cut_packet_is_refused(packet, missing):
    wire = ptp_ip.encode(packet)
    with pytest.raises(FrameError):
        ptp_ip.decode(wire[: max(0, len(wire) - missing)])


@given(NAME)
@settings(max_examples=50, deadline=None)
def test_strings_count_their_units(text):
    """One byte of count, two per unit, the closing zero counted; the empty string is one zero byte."""
    units = len(text.encode("utf-16-le")) // 2
    wire = ptp.encode_string(text)
    assert wire[0] == (units + 1 if text else 0)
    assert len(wire) == 1 + 2 * wire[0]


def test_an_overlong_string_is_refused():
    with pytest.raises(FrameError, match="too long"):
        ptp.encode_string("x" * 255)


def test_a_value_of_the_wrong_length_is_refused():
    with pytest.raises(FrameError, match="too many"):
        ptp.decode_value(4, b"\0\0\0")
    with pytest.raises(FrameError, match="not a number"):
        ptp.decode_value(0xFFFF, b"\0")


def test_a_name_that_does_not_end_is_refused():
    wire = ptp_ip.encode(ptp_ip.InitCommandRequest(bytes(16), "rig"))[:-6]
    with pytest.raises(FrameError):
        ptp_ip.decode(len(wire).to_bytes(4, "little") + wire[4:])


def test_a_camera_that_leaves_the_version_out_is_understood():
    wire = ptp_ip.encode(ptp_ip.InitCommandAck(1, bytes(16), "cam"))[:-4]
    assert ptp_ip.decode(len(wire).to_bytes(4, "little") + wire[4:]) == ptp_ip.InitCommandAck(1, bytes(16), "cam")
