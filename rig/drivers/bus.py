"""The serial bus that the TMCL modules share."""

from rig.config import Bus
from rig.drivers.clock import RigClock
from rig.drivers.link import Link
from rig.drivers.transport import SerialTransport
from rig.errors import FrameError, ReadTimeoutError, ReplyError
from rig.protocols import tmcl
from rig.protocols.tmcl import Reply, Request

_REPLY_TIMEOUT_S = 1.0  # two datagrams take 19 ms at 9600 baud; a module answers within a few more
_ATTEMPTS = 3


class TmclBus:
    """Requests to modules, one at a time.

    A reply answers a request when it echoes module and command. That cannot tell the late reply to one axis parameter
    from the reply to another: after a silence the module is asked for its version first, and what comes before that
    answer is dropped, because a module answers in order.
    """

    def __init__(self, config: Bus, clock: RigClock) -> None:
        """Nothing is opened yet."""
        transport = SerialTransport("bus", config.port, baudrate=config.baudrate)
        self._link: Link[Reply] = Link("bus", transport, tmcl.ReplyReader(), clock)
        self._suspects: set[int] = set()
        self._openings = 0

    def open(self) -> None:
        """Open the wire. Raises ConnectError."""
        self._link.open()
        self._openings += 1

    @property
    def openings(self) -> int:
        """How often the wire was opened; where that changes, modules may have lost power and position."""
        return self._openings

    def ask(self, device: str, request: Request, what: str, *, attempts: int = _ATTEMPTS) -> int:
        """Value of the reply. All requests of these drivers are safe to repeat, and are.

        Raises ReadTimeoutError or FrameError where no reply came, ReplyError where the module refuses.
        """
        for attempts_left in reversed(range(attempts)):
            try:
                reply = self._exchange(request, f"{device}: {what}")
            except (ReadTimeoutError, FrameError):
                if not attempts_left:
                    raise
                continue
            if reply.status == tmcl.STATUS_OK:
                return reply.value
            # Status "wrong checksum" means that the request came damaged: nothing was executed.
            if reply.status != tmcl.STATUS_WRONG_CHECKSUM or not attempts_left:
                break
        meaning = tmcl.STATUS_MEANING[reply.status]
        raise ReplyError(
            f"{device}: module {request.module} refuses {what}: {meaning} (status {reply.status}). "
            f"Last bytes: {self._link.trace()}"
        )

    def close(self) -> None:
        """Close the wire; closing twice is allowed."""
        self._link.close()

    def _exchange(self, request: Request, what: str) -> Reply:
        if not self._link.is_open:
            self.open()
        if request.module in self._suspects:
            self._once(tmcl.firmware_version(request.module), f"{what} (after a silence: version)")
            self._suspects.discard(request.module)
        self._suspects.add(request.module)  # until it has answered, whatever interrupts the waiting
        reply = self._once(request, what)
        self._suspects.discard(request.module)
        return reply

    def _once(self, request: Request, what: str) -> Reply:
        def answers(reply: Reply) -> bool:
            return reply.module == request.module and reply.command == request.command

        return self._link.request(tmcl.encode_request(request), answers, what=what, timeout_s=_REPLY_TIMEOUT_S)
