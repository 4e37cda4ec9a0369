"""Lamps behind an ENTTEC DMX USB Pro widget: levels in [0, 1] above, channels of 0 to 255 below."""

from collections.abc import Mapping

from rig.config import LampsConfig
from rig.drivers.clock import RigClock
from rig.drivers.link import Link
from rig.drivers.transport import SerialTransport
from rig.errors import ConfigError, LimitError, ReplyError, UnknownDeviceError
from rig.protocols import dmx
from rig.protocols.dmx import Label, Message

_REPLY_TIMEOUT_S = 1.0
_ATTEMPTS = 3
_BAUDRATE = 57600  # of no effect: the widget is a USB device (API 1.44, "PC Setup")
_LEVEL_MAX = 255


class EnttecLamps:
    """All lamps of one widget.

    DMX is one-way: that a lamp is lit shows only in a frame. What can be confirmed is that the widget took the levels:
    it works in order, so its answer to the question for its serial number, sent behind them, says so.
    """

    def __init__(self, config: LampsConfig, clock: RigClock) -> None:
        """Nothing is opened yet. Raises ConfigError where two lamps share a channel."""
        transport = SerialTransport("lamps", config.port, baudrate=_BAUDRATE)
        self._link: Link[Message] = Link("lamps", transport, dmx.MessageReader(), clock)
        self._channels = dict(sorted(((name, lamp.channel) for name, lamp in config.lamp.items()), key=lambda x: x[1]))
        if len(set(self._channels.values())) < len(self._channels):
            raise ConfigError("lamps: two lamps share a DMX channel. Channels are set in rig.toml, [lamps.lamp.NAME].")
        self._serial: int | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Lamp names in channel order."""
        return tuple(self._channels)

    def open(self) -> None:
        """Ask the widget who it is, and switch all lamps off. Raises what the link raises."""
        self._serial = self._ask_serial()
        self.off()

    def light(self, levels: Mapping[str, float]) -> None:
        """Set these lamps to their levels in [0, 1] and every other lamp to 0; returns when the widget has taken it.

        Raises UnknownDeviceError and LimitError before anything is lit, ReplyError where another widget answers.
        """
        self._check(levels)
        universe = bytearray(max(self._channels.values(), default=0))
        for name, level in levels.items():
            universe[self._channels[name] - 1] = round(level * _LEVEL_MAX)
        self._send(bytes(universe))

    def off(self) -> None:
        """All lamps to 0; returns when the widget has taken it."""
        self.light({})

    def close(self) -> None:
        """Close the wire; closing twice is allowed."""
        self._link.close()

    def _check(self, levels: Mapping[str, float]) -> None:
        for name, level in levels.items():
            if name not in self._channels:
                raise UnknownDeviceError(f"no lamp {name!r} in rig.toml; it has {', '.join(self.names)}.")
            if not 0 <= level <= 1:
                raise LimitError(f"lamp {name}: level {level:g} is outside 0 to 1; nothing was lit.")

    def _send(self, universe: bytes) -> None:
        # Twice: nothing tells a message that the widget lost, and the same levels do no harm.
        serial = self._ask_serial(2 * dmx.encode(dmx.output(universe)))
        if self._serial is not None and serial != self._serial:
            raise ReplyError(
                f"lamps: widget {serial} answers where {self._serial} was: the cable is in another port. "
                f"Last bytes: {self._link.trace()}"
            )

    def _ask_serial(self, before: bytes = b"") -> int:
        """The widget's serial number; a message in front of the question travels, and is repeated, with it."""
        reply = self._link.request(
            before + dmx.encode(dmx.serial_request()),
            lambda message: message.label == Label.SERIAL_NUMBER,
            what="the serial number" if not before else "the lamps' levels",
            timeout_s=_REPLY_TIMEOUT_S,
            attempts=_ATTEMPTS,
        )
        return dmx.serial_number(reply)
