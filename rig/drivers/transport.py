"""Byte streams to devices: serial ports and TCP sockets. Wall-time timeouts; no framing, no retry."""

import select
import socket
import termios
from typing import Protocol

import serial

from rig.drivers.clock import Deadline
from rig.errors import ConnectError, ReadTimeoutError, TransportError

_CONNECT_TIMEOUT_S = 5.0
_WRITE_TIMEOUT_S = 5.0
_SLICE_S = 0.02
_CHUNK = 1 << 16


class Transport(Protocol):
    """A stream of bytes to one wire. Errors name the device and what to do."""

    def open(self) -> None:
        """Open it, anew where it was closed. Raises ConnectError."""
        ...

    @property
    def is_open(self) -> bool:
        """Whether it is open, as far as is known."""
        ...

    def write(self, data: bytes) -> None:
        """Send all of it. Raises TransportError."""
        ...

    def read(self, timeout_s: float) -> bytes:
        """What has come, at least one byte. Raises ReadTimeoutError on silence, TransportError when unplugged."""
        ...

    def drain(self) -> bytes:
        """What has come by now, perhaps nothing; does not wait. Raises TransportError when unplugged."""
        ...

    def close(self) -> None:
        """Close it; closing twice is allowed."""
        ...


class SerialTransport:
    """A serial port: a path, or any URL that pyserial knows (`socket://`, `rfc2217://`, `spy://`)."""

    def __init__(self, device: str, url: str, *, baudrate: int, parity: str = serial.PARITY_NONE) -> None:
        """Nothing is opened yet; `device` names the owner in messages."""
        self._device = device
        self._url = url
        self._baudrate = baudrate
        self._parity = parity
        self._port: serial.Serial | None = None

    def open(self) -> None:
        """Open it, anew where it was closed. Raises ConnectError."""
        self.close()
        try:
            try:
                self._port = self._new_port(self._parity)
            except termios.error:
                # A pseudo-terminal knows no parity, and says so from the second opening on.
                self._port = self._new_port(serial.PARITY_NONE)
        except (OSError, ValueError, termios.error) as error:
            raise ConnectError(
                f"{self._device}: cannot open {self._url} ({error}). Is the adapter plugged in and free? "
                "Ports are named in rig.toml."
            ) from error

    @property
    def is_open(self) -> bool:
        """Whether it is open, as far as is known."""
        return self._port is not None

    def write(self, data: bytes) -> None:
        """Send all of it. Raises TransportError."""
        try:
            self._opened().write(data)
        except OSError as error:
            raise self._lost(error) from error

    def read(self, timeout_s: float) -> bytes:
        """What has come, at least one byte. Raises ReadTimeoutError on silence, TransportError when unplugged."""
        port, deadline = self._opened(), Deadline(timeout_s)
        try:
            while not (data := bytes(port.read(1))):
                if not deadline.left_s():
                    raise ReadTimeoutError(f"{self._device}: no byte from {self._url} within {timeout_s:.3g} s")
            return data + bytes(port.read(port.in_waiting))
        except ReadTimeoutError:
            raise
        except OSError as error:
            raise self._lost(error) from error

    def drain(self) -> bytes:
        """What has come by now, perhaps nothing; does not wait. Raises TransportError when unplugged."""
        port, data = self._opened(), b""
        try:
            while waiting := port.in_waiting:  # some ports tell no more than that there is something
                data += bytes(port.read(waiting))
            return data
        except OSError as error:
            raise self._lost(error) from error

    def close(self) -> None:
        """Close it; closing twice is allowed."""
        port, self._port = self._port, None
        if port is not None:
            port.close()

    def _new_port(self, parity: str) -> serial.Serial:
        options = {} if "://" in self._url else {"exclusive": True}
        return serial.serial_for_url(
            self._url,
            baudrate=self._baudrate,
            parity=parity,
            timeout=_SLICE_S,  # fixed: to change it would set the port up anew, which a pseudo-terminal refuses
            write_timeout=_WRITE_TIMEOUT_S,
            **options,
        )

    def _opened(self) -> serial.Serial:
        if self._port is None:
            raise TransportError(f"{self._device}: {self._url} is not open")
        return self._port

    def _lost(self, error: OSError) -> TransportError:
        self.close()
        return TransportError(f"{self._device}: lost {self._url} ({error}). Check the cable and the power, then go on.")


class SocketTransport:
    """A TCP connection."""

    def __init__(self, device: str, address: str) -> None:
        """Nothing is opened yet; `address` is host:port, `device` names the owner in messages."""
        self._device = device
        self._address = address
        self._socket: socket.socket | None = None

    def open(self) -> None:
        """Open it, anew where it was closed. Raises ConnectError."""
        self.close()
        host, _, port = self._address.rpartition(":")
        try:
            self._socket = socket.create_connection((host, int(port)), _CONNECT_TIMEOUT_S)
        except (OSError, ValueError) as error:
            raise ConnectError(
                f"{self._device}: cannot connect to {self._address} ({error}). Is it switched on and in the network? "
                "Addresses are host:port in rig.toml."
            ) from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    @property
    def is_open(self) -> bool:
        """Whether it is open, as far as is known."""
        return self._socket is not None

    def write(self, data: bytes) -> None:
        """Send all of it. Raises TransportError."""
        stream = self._opened()
        try:
            stream.settimeout(_WRITE_TIMEOUT_S)
            stream.sendall(data)
        except OSError as error:
            raise self._lost(str(error)) from error

    def read(self, timeout_s: float) -> bytes:
        """What has come, at least one byte. Raises ReadTimeoutError on silence, TransportError when unplugged."""
        stream = self._opened()
        try:
            if not select.select([stream], [], [], timeout_s)[0]:
                raise ReadTimeoutError(f"{self._device}: no byte from {self._address} within {timeout_s:.3g} s")
            data = stream.recv(_CHUNK)
        except ReadTimeoutError:
            raise
        except OSError as error:
            raise self._lost(str(error)) from error
        if not data:
            raise self._lost("the other end hung up")
        return data

    def drain(self) -> bytes:
        """What has come by now, perhaps nothing; does not wait. Raises TransportError when unplugged."""
        try:
            return self.read(0.0)
        except ReadTimeoutError:
            return b""

    def close(self) -> None:
        """Close it; closing twice is allowed."""
        stream, self._socket = self._socket, None
        if stream is not None:
            stream.close()

    def _opened(self) -> socket.socket:
        if self._socket is None:
            raise TransportError(f"{self._device}: {self._address} is not connected")
        return self._socket

    def _lost(self, why: str) -> TransportError:
        self.close()
        return TransportError(
            f"{self._device}: lost {self._address} ({why}). Check the cable and the power, then go on."
        )
