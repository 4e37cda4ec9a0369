"""PTP datasets and their scalars: strings, arrays, device information, properties (ISO 15740)."""

import struct
from dataclasses import dataclass
from enum import IntEnum

from rig.errors import FrameError


class Operation(IntEnum):
    """Operation codes."""

    GET_DEVICE_INFO = 0x1001
    OPEN_SESSION = 0x1002
    CLOSE_SESSION = 0x1003
    GET_STORAGE_IDS = 0x1004
    GET_OBJECT_HANDLES = 0x1007
    GET_OBJECT_INFO = 0x1008
    GET_OBJECT = 0x1009
    DELETE_OBJECT = 0x100B
    INITIATE_CAPTURE = 0x100E
    GET_PROPERTY_DESC = 0x1014
    GET_PROPERTY_VALUE = 0x1015
    SET_PROPERTY_VALUE = 0x1016
    TERMINATE_OPEN_CAPTURE = 0x1018


class Response(IntEnum):
    """Response codes."""

    OK = 0x2001
    GENERAL_ERROR = 0x2002
    SESSION_NOT_OPEN = 0x2003
    INVALID_TRANSACTION = 0x2004
    OPERATION_NOT_SUPPORTED = 0x2005
    PARAMETER_NOT_SUPPORTED = 0x2006
    INCOMPLETE_TRANSFER = 0x2007
    INVALID_STORAGE = 0x2008
    INVALID_OBJECT_HANDLE = 0x2009
    PROPERTY_NOT_SUPPORTED = 0x200A
    STORE_FULL = 0x200C
    STORE_NOT_AVAILABLE = 0x2013
    DEVICE_BUSY = 0x2019
    INVALID_PROPERTY_VALUE = 0x201C
    INVALID_PARAMETER = 0x201D
    SESSION_ALREADY_OPEN = 0x201E


class Event(IntEnum):
    """Event codes."""

    OBJECT_ADDED = 0x4002
    CAPTURE_COMPLETE = 0x400D


class ObjectFormat(IntEnum):
    """Formats of stored objects (ISO 15740, "Object formats"; DNG of PTP 1.1)."""

    ANY = 0
    JPEG = 0x3801  # with EXIF
    DNG = 0x3811


class Property(IntEnum):
    """Device properties: f-number in 0.01, exposure time in 0.1 ms, burst interval in ms.

    SHUTTER_SPEED is an extension of Ricoh's for times that 0.1 ms is too coarse for: seconds as `decode_speed` has them
    (Ricoh Theta API reference, 0xD00F ShutterSpeed).
    """

    F_NUMBER = 0x5007
    EXPOSURE_TIME = 0x500D
    EXPOSURE_INDEX = 0x500F
    STILL_CAPTURE_MODE = 0x5013
    BURST_NUMBER = 0x5018
    BURST_INTERVAL = 0x5019
    SHUTTER_SPEED = 0xD00F


class CaptureMode(IntEnum):
    """Values of STILL_CAPTURE_MODE."""

    NORMAL = 1
    BURST = 2


MTP_EXTENSION = 6  # vendor extension id of cameras that speak MTP, Ricoh's among them
ANY = 0xFFFFFFFF  # all storages, or objects at any place of the store
SCALARS = {1: "b", 2: "B", 3: "h", 4: "H", 5: "i", 6: "I", 7: "q", 8: "Q"}
"""Data type codes of numbers, with the letter of struct."""
PROPERTY_TYPES = {
    Property.F_NUMBER: 4,
    Property.EXPOSURE_TIME: 6,
    Property.EXPOSURE_INDEX: 4,
    Property.STILL_CAPTURE_MODE: 4,
    Property.BURST_NUMBER: 4,
    Property.BURST_INTERVAL: 4,
    Property.SHUTTER_SPEED: 8,
}
_FORM_RANGE = 1
_FORM_ENUMERATION = 2


@dataclass(frozen=True, slots=True)
class DeviceInfo:
    """Who the camera is and what it can do."""

    standard_version: int
    vendor_extension: int
    vendor_extension_version: int
    vendor_extension_description: str
    functional_mode: int
    operations: tuple[int, ...]
    events: tuple[int, ...]
    properties: tuple[int, ...]
    capture_formats: tuple[int, ...]
    image_formats: tuple[int, ...]
    manufacturer: str
    model: str
    device_version: str
    serial: str


@dataclass(frozen=True, slots=True)
class ObjectInfo:
    """One stored object, a frame; thumbnail and association fields are left out."""

    storage: int
    format: int
    size: int
    width_px: int
    height_px: int
    bits: int
    parent: int
    sequence: int
    filename: str
    captured: str


@dataclass(frozen=True, slots=True)
class PropertyDesc:
    """A property of number type, its value now, and its range (minimum, maximum, step) or its list of values."""

    code: int
    data_type: int
    writable: bool
    default: int
    current: int
    range: tuple[int, int, int] | None
    values: tuple[int, ...]


def encode_string(text: str) -> bytes:
    """Count of 16-bit units with the closing zero, then UTF-16LE; one zero byte where empty.

    Raises FrameError above 254 units.
    """
    units = text.encode("utf-16-le")
    if len(units) // 2 > 254:
        raise FrameError(f"too long for a PTP string: {text!r}")
    return bytes([len(units) // 2 + 1]) + units + b"\0\0" if text else b"\0"


def encode_value(data_type: int, value: int) -> bytes:
    """A number of that type code."""
    return struct.pack("<" + SCALARS[data_type], value)


def decode_value(data_type: int, data: bytes) -> int:
    """Raises FrameError where the length does not fit the type."""
    fields = _Fields(data)
    value = fields.scalar(data_type)
    fields.end("property value")
    return value


def encode_speed(numerator: int, denominator: int) -> int:
    """A shutter speed as the value of its property: the numerator in the lower 32 bits, the denominator above."""
    return denominator << 32 | numerator


def decode_speed(value: int) -> tuple[int, int]:
    """Numerator and denominator of a shutter speed; (0, 0) where the camera chooses it itself."""
    return value & 0xFFFFFFFF, value >> 32


def encode_u32_array(values: tuple[int, ...]) -> bytes:
    """Count, then the numbers: storage ids, object handles."""
    return struct.pack(f"<I{len(values)}I", len(values), *values)


def decode_u32_array(data: bytes) -> tuple[int, ...]:
    """Raises FrameError where the count and the length disagree."""
    fields = _Fields(data)
    values = fields.array("I")
    fields.end("array")
    return values


def encode_device_info(info: DeviceInfo) -> bytes:
    """The DeviceInfo dataset."""
    arrays = (info.operations, info.events, info.properties, info.capture_formats, info.image_formats)
    strings = (info.manufacturer, info.model, info.device_version, info.serial)
    return b"".join(
        [
            struct.pack("<HIH", info.standard_version, info.vendor_extension, info.vendor_extension_version),
            encode_string(info.vendor_extension_description),
            struct.pack("<H", info.functional_mode),
            *(struct.pack(f"<I{len(codes)}H", len(codes), *codes) for codes in arrays),
            *(encode_string(text) for text in strings),
        ]
    )


def decode_device_info(data: bytes) -> DeviceInfo:
    """Raises FrameError where the dataset is cut."""
    fields = _Fields(data)
    return DeviceInfo(
        standard_version=fields.number("H"),
        vendor_extension=fields.number("I"),
        vendor_extension_version=fields.number("H"),
        vendor_extension_description=fields.string(),
        functional_mode=fields.number("H"),
        operations=fields.array("H"),
        events=fields.array("H"),
        properties=fields.array("H"),
        capture_formats=fields.array("H"),
        image_formats=fields.array("H"),
        manufacturer=fields.string(),
        model=fields.string(),
        device_version=fields.string(),
        serial=fields.string(),
    )


def encode_object_info(info: ObjectInfo) -> bytes:
    """The ObjectInfo dataset: no thumbnail, no protection, no association, no keywords."""
    head = struct.pack("<IHHIHIII", info.storage, info.format, 0, info.size, 0, 0, 0, 0)
    image = struct.pack("<IIIIHII", info.width_px, info.height_px, info.bits, info.parent, 0, 0, info.sequence)
    return head + image + encode_string(info.filename) + encode_string(info.captured) + b"\0\0"


def decode_object_info(data: bytes) -> ObjectInfo:
    """Raises FrameError where the dataset is cut."""
    fields = _Fields(data)
    storage, kind, _protection, size, *_thumbnail = (fields.number(letter) for letter in "IHHIHIII")
    width_px, height_px, bits, parent, _, _, sequence = (fields.number(letter) for letter in "IIIIHII")
    filename, captured = fields.string(), fields.string()
    return ObjectInfo(storage, kind, size, width_px, height_px, bits, parent, sequence, filename, captured)


def encode_property_desc(desc: PropertyDesc) -> bytes:
    """The DevicePropDesc dataset of a number."""
    head = struct.pack("<HHB", desc.code, desc.data_type, desc.writable)
    form = b"\0"
    if desc.range is not None:
        form = bytes([_FORM_RANGE]) + b"".join(encode_value(desc.data_type, value) for value in desc.range)
    elif desc.values:
        values = b"".join(encode_value(desc.data_type, value) for value in desc.values)
        form = struct.pack("<BH", _FORM_ENUMERATION, len(desc.values)) + values
    return head + encode_value(desc.data_type, desc.default) + encode_value(desc.data_type, desc.current) + form


def decode_property_desc(data: bytes) -> PropertyDesc:
    """Raises FrameError where the dataset is cut or the property is not a number."""
    fields = _Fields(data)
    code, data_type, writable = (fields.number(letter) for letter in "HHB")
    default, current = fields.scalar(data_type), fields.scalar(data_type)
    form = fields.number("B")
    limits: tuple[int, int, int] | None = None
    values: tuple[int, ...] = ()
    if form == _FORM_RANGE:
        limits = (fields.scalar(data_type), fields.scalar(data_type), fields.scalar(data_type))
    elif form == _FORM_ENUMERATION:
        values = tuple(fields.scalar(data_type) for _ in range(fields.number("H")))
    fields.end("property description")
    return PropertyDesc(code, data_type, bool(writable), default, current, limits, values)


class _Fields:
    """Reads a dataset from front to back. Raises FrameError where it ends too early."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def number(self, letter: str) -> int:
        layout = struct.Struct("<" + letter)
        return int(layout.unpack(self._take(layout.size))[0])

    def scalar(self, data_type: int) -> int:
        if data_type not in SCALARS:
            raise FrameError(f"PTP data type {data_type:#06x} is not a number")
        return self.number(SCALARS[data_type])

    def array(self, letter: str) -> tuple[int, ...]:
        count = self.number("I")
        size = struct.calcsize("<" + letter)
        return tuple(value for (value,) in struct.iter_unpack("<" + letter, self._take(count * size)))

    def string(self) -> str:
        try:
            return self._take(2 * self.number("B")).decode("utf-16-le").removesuffix("\0")
        except UnicodeDecodeError as error:
            raise FrameError(f"not a PTP string: {self._data.hex(' ')}") from error

    def end(self, what: str) -> None:
        if self._at != len(self._data):
            raise FrameError(f"PTP {what} with {len(self._data) - self._at} bytes too many: {self._data.hex(' ')}")

    def _take(self, count: int) -> bytes:
        part = self._data[self._at : self._at + count]
        if len(part) != count:
            raise FrameError(f"PTP dataset ends after {len(self._data)} bytes: {self._data[:64].hex(' ')}")
        self._at += count
        return part
