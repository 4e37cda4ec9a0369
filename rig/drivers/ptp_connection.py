"""A PTP session over PTP/IP: transactions on the command connection, events on the other."""

from collections.abc import Callable

from rig.drivers.clock import RigClock
from rig.drivers.link import Link
from rig.drivers.transport import SocketTransport
from rig.errors import ConnectError, FrameError, ReplyError
from rig.protocols import ptp, ptp_ip
from rig.protocols.ptp import DeviceInfo, Operation, Response
from rig.protocols.ptp_ip import (
    Data,
    EndData,
    EventPacket,
    InitCommandAck,
    InitEventAck,
    InitFail,
    OperationRequest,
    OperationResponse,
    Packet,
    StartData,
)

_GUID = b"appearance-rig\0\0"
_NAME = "appearance rig"
_SESSION = 1
_INIT_TIMEOUT_S = 5.0
_REPLY_TIMEOUT_S = 10.0
_QUIET_S = 3.0  # within a packet


class ResponseError(ReplyError):
    """The camera ended a transaction with another response than OK; `code` says which."""

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code


class PtpConnection:
    """Both connections to one camera."""

    def __init__(self, camera: str, address: str, clock: RigClock) -> None:
        """Nothing is opened yet."""
        self._camera = camera
        self._commands: Link[Packet] = _link(camera, address, clock)
        self._events: Link[Packet] = _link(camera, address, clock)
        self._transaction = 0

    @property
    def is_open(self) -> bool:
        """Whether both connections stand, as far as is known."""
        return self._commands.is_open and self._events.is_open

    def open(self) -> DeviceInfo:
        """Connect, open the session, and tell who is there. Raises ConnectError where the camera refuses."""
        self.close()
        try:
            ack = self._init(self._commands, ptp_ip.InitCommandRequest(_GUID, _NAME))
            if not isinstance(ack, InitCommandAck):
                raise self._refused(ack)
            answer = self._init(self._events, ptp_ip.InitEventRequest(ack.connection))
            if not isinstance(answer, InitEventAck):
                raise self._refused(answer)
            self._transaction = 0
            self._open_session()
            return ptp.decode_device_info(self.transact(Operation.GET_DEVICE_INFO))
        except BaseException:
            self.close()
            raise

    def transact(
        self, operation: Operation, *parameters: int, data: bytes | None = None, timeout_s: float | None = None
    ) -> bytes:
        """Carry out one operation; returns what its data phase brought.

        `data` goes out where given. Packets of other transactions are dropped, so that a late answer is never taken for
        this one's. Raises ResponseError where the camera refuses, ReadTimeoutError where it stays silent; FrameError
        where its answer was cut: then the connection is closed, because what follows cannot be told from the rest.
        """
        transaction = self._transaction
        self._transaction += 1
        phase = ptp_ip.NO_DATA_OUT if data is None else ptp_ip.DATA_OUT
        wire = ptp_ip.encode(OperationRequest(phase, operation, transaction, parameters))
        if data is not None:
            wire += ptp_ip.encode(StartData(transaction, len(data))) + ptp_ip.encode(EndData(transaction, data))
        self._commands.send(wire)
        return self._collect(operation, transaction, _REPLY_TIMEOUT_S if timeout_s is None else timeout_s)

    def events(self) -> list[EventPacket]:
        """The events that have come by now; probes are answered."""
        events = []
        for packet in self._events.poll():
            if isinstance(packet, ptp_ip.Ping):
                self._events.send(ptp_ip.encode(ptp_ip.Pong()))
            elif isinstance(packet, EventPacket):
                events.append(packet)
        return events

    @property
    def last_transaction(self) -> int:
        """Number of the transaction carried out last; events name it."""
        return self._transaction - 1

    def close(self) -> None:
        """Hang up; closing twice is allowed. The camera ends the session by itself."""
        self._commands.close()
        self._events.close()

    def _collect(self, operation: Operation, transaction: int, timeout_s: float) -> bytes:
        """Data phase and response. A camera that goes on sending gets `timeout_s` for each packet."""
        announced: int | None = None
        parts: list[bytes] = []

        def belongs(packet: Packet) -> bool:
            return isinstance(packet, StartData | Data | EndData | OperationResponse) and (
                packet.transaction == transaction
            )

        while True:
            match self._receive(belongs, operation, timeout_s):
                case StartData(_, length):
                    announced, parts = length, []
                case Data(_, payload) | EndData(_, payload):
                    parts.append(payload)
                case OperationResponse(code, _, _) if code != Response.OK:
                    raise self._response_error(operation, code)
                case OperationResponse():
                    data = b"".join(parts)
                    if len(data) != (announced or 0):
                        raise FrameError(f"{self._camera}: {operation.name} brought {len(data)} of {announced} bytes.")
                    return data

    def _receive(self, belongs: Callable[[Packet], bool], operation: Operation, timeout_s: float) -> Packet:
        try:
            return self._commands.receive(belongs, what=operation.name, timeout_s=timeout_s)
        except FrameError:
            self.close()
            raise

    def _open_session(self) -> None:
        try:
            self.transact(Operation.OPEN_SESSION, _SESSION)
        except ResponseError as error:
            if error.code != Response.SESSION_ALREADY_OPEN:
                raise

    def _init(self, link: Link[Packet], request: Packet) -> Packet:
        link.open()
        link.send(ptp_ip.encode(request))
        return link.receive(
            lambda packet: isinstance(packet, InitCommandAck | InitEventAck | InitFail),
            what="the PTP/IP greeting",
            timeout_s=_INIT_TIMEOUT_S,
        )

    def _refused(self, answer: Packet) -> ConnectError:
        return ConnectError(
            f"{self._camera}: refuses the connection ({answer}). Is another program connected to it? Last bytes: "
            f"{self._commands.trace()}"
        )

    def _response_error(self, operation: Operation, code: int) -> ResponseError:
        known = {response.value: response.name.lower().replace("_", " ") for response in Response}
        meaning = known.get(code, "unknown response")
        return ResponseError(
            f"{self._camera}: refuses {operation.name}: {meaning} ({code:#06x}). Last bytes: {self._commands.trace()}",
            code,
        )


def _link(camera: str, address: str, clock: RigClock) -> Link[Packet]:
    return Link(camera, SocketTransport(camera, address), ptp_ip.PacketReader(), clock, quiet_s=_QUIET_S)
