"""The way back over a wire: replies with their pacing and the faults that strike them."""

from collections.abc import Callable

from simulators.clock import Clock
from simulators.faults import Fault, FaultSchedule, Occasion


class Line:
    """Carries the replies of the devices on one wire.

    A request is announced by `request`, its reply handed over by `reply`; both charge the wire's time to the clock.
    """

    def __init__(self, name: str, clock: Clock, faults: FaultSchedule, bytes_per_s: float) -> None:
        self.name = name
        self.write: Callable[[bytes], None] = lambda _: None
        self.unplug: Callable[[float], None] = lambda _: None
        self._clock = clock
        self._faults = faults
        self._bytes_per_s = bytes_per_s
        self._held = b""

    def request(self, length: int, device: str | None = None) -> Fault | None:
        """Charge a request of that many bytes and tell the fault that strikes it."""
        self.charge(length)
        names = (self.name,) if device is None else (self.name, device)
        return self._faults.strike(names, Occasion.MESSAGE, self._clock.now_s())

    def charge(self, length: int) -> None:
        """Let the time pass that these bytes need on the wire."""
        self._clock.advance(length / self._bytes_per_s)

    def reply(self, data: bytes, fault: Fault | None) -> None:
        """Send a reply, or what the fault leaves of it."""
        self.charge(len(data))
        kind, seconds = (fault.kind, fault.seconds) if fault else ("", 0.0)
        match kind:
            case "drop":
                return
            case "stale":
                self._held += data
                return
            case "delay":
                late = self._held + data
                self._clock.after(seconds, lambda: self.write(late))
            case "unplug":
                self.unplug(seconds)
            case "duplicate":
                self.write(self._held + data + data)
            case "corrupt":
                self.write(self._held + corrupted(data))
            case "truncate":
                self.write(self._held + data[: len(data) // 2])
            case _:
                self.write(self._held + data)
        self._held = b""


def corrupted(data: bytes) -> bytes:
    """The data, if any, with bits of its middle byte changed."""
    if not data:
        return data
    middle = len(data) // 2
    return data[:middle] + bytes([data[middle] ^ 0x55]) + data[middle + 1 :]
