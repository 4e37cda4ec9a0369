"""A PTP camera: operations, properties, objects and events, whatever carries them.

Source: ISO 15740:2013 (PTP), clauses 10 (operations), 11 (responses), 12 (events), 13 (device properties); data sets of
clause 5. The object format of DNG files is that of PTP 1.1.
"""

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import timedelta
from typing import ClassVar

from simulators.dng import EPOCH
from simulators.faults import Fault
from simulators.layout import CameraLabel
from simulators.line import corrupted
from simulators.shutter import TICK_S, Release, Shutter

OK, GENERAL_ERROR, NO_SESSION, UNSUPPORTED, NO_STORE, NO_OBJECT = 0x2001, 0x2002, 0x2003, 0x2005, 0x2008, 0x2009
NO_PROPERTY, BUSY, BAD_FORMAT, BAD_VALUE, SESSION_OPEN = 0x200A, 0x2019, 0x201B, 0x201C, 0x201E
BAD_PARAMETER = 0x201D
OBJECT_ADDED, CAPTURE_COMPLETE = 0x4002, 0x400D
GET_DEVICE_INFO, OPEN_SESSION = 0x1001, 0x1002
EXPOSURE_TIME, EXPOSURE_INDEX, F_NUMBER, CAPTURE_MODE = 0x500D, 0x500F, 0x5007, 0x5013
BURST_NUMBER, BURST_INTERVAL, BATTERY = 0x5018, 0x5019, 0x5001
SHUTTER_SPEED = 0xD00F  # of Ricoh's: numerator in the lower 32 bits, denominator in the upper (Theta API reference)
JPEG, DNG = 0x3801, 0x3811
ENDINGS = {JPEG: "JPG", DNG: "DNG"}
BITS = {JPEG: 8, DNG: 16}
MTP = 6  # vendor extension
STORAGE = 0x00010001
CAPACITY = 64 << 30
SINGLE, BURST = 1, 2
ALL = 0xFFFFFFFF
TYPES = {2: "<B", 4: "<H", 6: "<I", 8: "<Q"}  # PTP data type code: struct format


class ResponseError(Exception):
    """An operation that ends in this response code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"response {code:#06x}")
        self.code = code


@dataclass
class Property:
    """A device property: range (lowest, highest, step) or the values it may take."""

    type: int
    value: int
    writable: bool
    range: tuple[int, int, int] | None = None
    values: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        self.factory = self.value

    def pack(self, value: int) -> bytes:
        """A value in the property's type."""
        return struct.pack(TYPES[self.type], value)

    def set(self, data: bytes) -> None:
        """Take a value as it came. Raises ResponseError."""
        if not self.writable:
            raise ResponseError(0x200F)  # access denied
        if len(data) != struct.calcsize(TYPES[self.type]):
            raise ResponseError(BAD_FORMAT)
        (value,) = struct.unpack(TYPES[self.type], data)
        inside = value in self.values if self.range is None else self.range[0] <= value <= self.range[1]
        if not inside:
            raise ResponseError(BAD_VALUE)
        self.value = value

    def description(self, code: int) -> bytes:
        """The DevicePropDesc data set (clause 13.3.3)."""
        head = struct.pack("<HHB", code, self.type, int(self.writable))
        values = b"".join(self.pack(value) for value in self.range or self.values)
        form = b"\x01" if self.range is not None else b"\x02" + struct.pack("<H", len(self.values))
        return head + self.pack(self.factory) + self.pack(self.value) + form + values


def _properties() -> dict[int, Property]:
    return {
        BATTERY: Property(2, 95, writable=False, range=(0, 100, 1)),
        F_NUMBER: Property(4, 800, writable=True, values=(800,)),
        EXPOSURE_TIME: Property(6, 100, writable=True, range=(1, 600_000, 1)),
        EXPOSURE_INDEX: Property(4, 100, writable=True, values=(100,)),
        CAPTURE_MODE: Property(4, SINGLE, writable=True, values=(SINGLE, BURST)),
        BURST_NUMBER: Property(4, 1, writable=True, range=(1, 1000, 1)),
        BURST_INTERVAL: Property(4, 133, writable=True, range=(0, 65535, 1)),
    }


@dataclass(frozen=True)
class Make:
    """What sets one make of camera apart on the wire; the first of its formats is what it takes unless told."""

    formats: tuple[int, ...]
    vendor_extension: int
    properties: Callable[[], dict[int, Property]]


def phone_make(speeds: Sequence[tuple[int, int]]) -> Make:
    """A phone-like camera, which is told one of its shutter speeds (numerator, denominator) and has both formats."""

    def properties() -> dict[int, Property]:
        values = tuple(bottom << 32 | top for top, bottom in speeds)
        others = {code: one for code, one in _properties().items() if code not in (EXPOSURE_TIME, F_NUMBER)}
        fixed = Property(4, 180, writable=True, values=(180,))
        return others | {F_NUMBER: fixed, SHUTTER_SPEED: Property(8, values[len(values) // 2], True, None, values)}

    return Make((JPEG, DNG), MTP, properties)


MOUNTED = Make((DNG,), 0, _properties)


@dataclass(frozen=True, slots=True)
class Stored:
    """A file in the camera's memory."""

    name: str
    format: int
    data: bytes
    taken_s: float


@dataclass(frozen=True, slots=True)
class Request:
    """An operation's transaction, its first three parameters and the data that the host sent."""

    transaction: int
    parameters: tuple[int, ...]
    data: bytes


@dataclass
class Camera:
    """One camera. `notify` sends an event: code, transaction, parameters."""

    layout: CameraLabel
    shutter: Shutter
    now_s: Callable[[], float]
    make: Make = MOUNTED
    notify: Callable[[int, int, tuple[int, ...]], None] = field(default=lambda *_: None)

    def __post_init__(self) -> None:
        self.properties = self.make.properties()
        self.objects: dict[int, Stored] = {}
        self.session: int | None = None
        self._next_handle = 1

    def operate(
        self, code: int, transaction: int, parameters: Sequence[int], data: bytes
    ) -> tuple[int, tuple[int, ...], bytes]:
        """Carry out an operation; response code, response parameters and data for the host."""
        handler = self._operations.get(code)
        try:
            if handler is None:
                raise ResponseError(UNSUPPORTED)
            if self.session is None and code not in (GET_DEVICE_INFO, OPEN_SESSION):
                raise ResponseError(NO_SESSION)
            padded = (*parameters, 0, 0, 0)[:3]
            answer = handler(self, Request(transaction, padded, data))
        except ResponseError as refusal:
            return refusal.code, (), b""
        return (OK, (), answer) if isinstance(answer, bytes) else (OK, answer, b"")

    def close(self) -> None:
        """End the session; exposures under way are dropped, the memory is kept."""
        self.shutter.abort()
        self.session = None

    def _device_info(self, _: Request) -> bytes:
        return b"".join([
            struct.pack("<HIH", 100, self.make.vendor_extension, 100),
            _string(""),
            struct.pack("<H", 0),
            _array16(sorted(self._operations)),
            _array16([OBJECT_ADDED, CAPTURE_COMPLETE]),
            _array16(sorted(self.properties)),
            _array16(self.make.formats),
            _array16(self.make.formats),
            _string("Virtual Cameras"),
            _string(self.layout.model),
            _string("1.0"),
            _string(self.layout.serial),
        ])  # fmt: skip

    def _open_session(self, request: Request) -> bytes:
        if self.session is not None:
            raise ResponseError(SESSION_OPEN)
        if request.parameters[0] == 0:
            raise ResponseError(BAD_PARAMETER)
        self.session = request.parameters[0]
        return b""

    def _close_session(self, _: Request) -> bytes:
        self.close()
        return b""

    def _storage_ids(self, _: Request) -> bytes:
        return _array32([STORAGE])

    def _storage_info(self, request: Request) -> bytes:
        if request.parameters[0] != STORAGE:
            raise ResponseError(NO_STORE)
        free = CAPACITY - sum(len(stored.data) for stored in self.objects.values())
        frame = 2 * self.layout.width_px * self.layout.height_px
        return struct.pack("<HHHQQI", 4, 1, 0, CAPACITY, free, free // frame) + _string("memory card") + _string("")

    def _handles(self, request: Request) -> list[int]:
        storage, form, parent = request.parameters
        if storage not in (STORAGE, ALL):
            raise ResponseError(NO_STORE)
        if parent not in (0, ALL):
            return []
        return sorted(handle for handle, stored in self.objects.items() if form in (0, ALL, stored.format))

    def _count(self, request: Request) -> tuple[int, ...]:
        return (len(self._handles(request)),)

    def _list(self, request: Request) -> bytes:
        return _array32(self._handles(request))

    def _stored(self, request: Request) -> Stored:
        if request.parameters[0] not in self.objects:
            raise ResponseError(NO_OBJECT)
        return self.objects[request.parameters[0]]

    def _object_info(self, request: Request) -> bytes:
        stored = self._stored(request)
        taken = _string((EPOCH + timedelta(seconds=stored.taken_s)).strftime("%Y%m%dT%H%M%S"))
        return b"".join([
            struct.pack("<IHHI", STORAGE, stored.format, 0, len(stored.data)),
            struct.pack("<HIII", 0, 0, 0, 0),
            struct.pack("<III", self.layout.width_px, self.layout.height_px, BITS[stored.format]),
            struct.pack("<IHII", 0, 0, 0, request.parameters[0]),
            _string(stored.name), taken, taken, _string(""),
        ])  # fmt: skip

    def _object(self, request: Request) -> bytes:
        return self._stored(request).data

    def _delete(self, request: Request) -> bytes:
        if request.parameters[0] == ALL:
            self.objects.clear()
            return b""
        self._stored(request)
        del self.objects[request.parameters[0]]
        return b""

    def _capture(self, request: Request) -> bytes:
        storage, form, _ = request.parameters
        if storage not in (0, STORAGE):
            raise ResponseError(NO_STORE)
        form = form or self.make.formats[0]
        if form not in self.make.formats:
            raise ResponseError(0x200B)  # invalid object format
        if self.shutter.busy:
            raise ResponseError(BUSY)
        burst = self.properties[CAPTURE_MODE].value == BURST
        release = Release(
            exposure_s=self._exposure_s(),
            jpeg=form == JPEG,
            frames=self.properties[BURST_NUMBER].value if burst else 1,
            interval_s=self.properties[BURST_INTERVAL].value / 1000,
            deliver=lambda image: self._store(image, form, request.transaction),
            complete=lambda: self.notify(CAPTURE_COMPLETE, request.transaction, ()),
        )
        self.shutter.release(release)
        return b""

    def _exposure_s(self) -> float:
        if SHUTTER_SPEED in self.properties:
            speed = self.properties[SHUTTER_SPEED].value
            return (speed & 0xFFFFFFFF) / (speed >> 32)
        return round(self.properties[EXPOSURE_TIME].value * TICK_S, 4)

    def _store(self, image: bytes, form: int, transaction: int) -> None:
        handle = self._next_handle
        self._next_handle += 1
        self.objects[handle] = Stored(f"IMG_{handle:05d}.{ENDINGS[form]}", form, image, self.now_s())
        self.notify(OBJECT_ADDED, transaction, (handle,))

    def _terminate(self, _: Request) -> bytes:
        self.shutter.abort()
        return b""

    def _property(self, request: Request) -> Property:
        if request.parameters[0] not in self.properties:
            raise ResponseError(NO_PROPERTY)
        return self.properties[request.parameters[0]]

    def _describe(self, request: Request) -> bytes:
        return self._property(request).description(request.parameters[0])

    def _get(self, request: Request) -> bytes:
        wanted = self._property(request)
        return wanted.pack(wanted.value)

    def _set(self, request: Request) -> bytes:
        wanted = self._property(request)
        if self.shutter.busy:
            raise ResponseError(BUSY)
        wanted.set(request.data)
        return b""

    _operations: ClassVar[dict[int, Callable[["Camera", Request], bytes | tuple[int, ...]]]] = {
        GET_DEVICE_INFO: _device_info,
        OPEN_SESSION: _open_session,
        0x1003: _close_session,
        0x1004: _storage_ids,
        0x1005: _storage_info,
        0x1006: _count,
        0x1007: _list,
        0x1008: _object_info,
        0x1009: _object,
        0x100B: _delete,
        0x100E: _capture,
        0x1014: _describe,
        0x1015: _get,
        0x1016: _set,
        0x1018: _terminate,  # TerminateOpenCapture: this camera ends a burst with it as well
    }


def strike(fault: Fault | None, data: bytes) -> bytes:
    """An object as the fault leaves it: cut or changed, but well framed."""
    if fault is None or fault.kind not in ("truncate", "corrupt"):
        return data
    return data[: len(data) // 2] if fault.kind == "truncate" else corrupted(data)


def _string(text: str) -> bytes:
    if not text:
        return b"\0"
    return bytes([len(text) + 1]) + text.encode("utf-16-le") + b"\0\0"


def _array16(values: Sequence[int]) -> bytes:
    return struct.pack(f"<I{len(values)}H", len(values), *values)


def _array32(values: Sequence[int]) -> bytes:
    return struct.pack(f"<I{len(values)}I", len(values), *values)
