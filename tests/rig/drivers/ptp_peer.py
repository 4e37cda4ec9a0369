"""A scripted PTP/IP camera and a minimal DNG, both from struct alone (vectors/ptp.toml; DNG specification 1.7)."""

import struct
import threading

from tests.rig.drivers.peers import read_exactly

OK, BUSY = 0x2001, 0x2019


def dng(*, serial="VC-0000", exposure_ticks=333, pixels=64, stamp=None):
    """Little-endian TIFF: one strip of 16-bit pixels, CameraSerialNumber, and ExposureTime in an Exif directory.

    `stamp` is DateTimeOriginal and SubSecTimeOriginal, the latter of four characters or more.
    """
    serial_bytes = serial.encode() + b"\0"
    texts = [text.encode() + b"\0" for text in stamp or ()]
    main, exif = 7, 1 + len(texts)
    exif_at = 8 + 2 + 12 * main + 4
    rational_at = exif_at + 2 + 12 * exif + 4
    serial_at = rational_at + 8
    texts_at = serial_at + len(serial_bytes) + len(serial_bytes) % 2
    strip_at = texts_at + sum(map(len, texts))
    strip_at += strip_at % 2
    entries = [
        (256, 4, 1, pixels),
        (257, 4, 1, 1),
        (262, 4, 1, 32803),
        (273, 4, 1, strip_at),
        (279, 4, 1, 2 * pixels),
        (34665, 4, 1, exif_at),
        (0xC62F, 2, len(serial_bytes), serial_at),
    ]
    head = struct.pack("<2sHI", b"II", 42, 8) + struct.pack("<H", main)
    head += b"".join(struct.pack("<HHII", *entry) for entry in entries) + struct.pack("<I", 0)
    head += struct.pack("<H", exif) + struct.pack("<HHII", 33434, 5, 1, rational_at)
    for tag, text, before in zip((36867, 37521), texts, (0, len(texts[0]) if texts else 0), strict=False):
        head += struct.pack("<HHII", tag, 2, len(text), texts_at + before)
    head += struct.pack("<I", 0) + struct.pack("<II", exposure_ticks, 10_000) + serial_bytes
    head = head.ljust(texts_at, b"\0") + b"".join(texts)
    return head.ljust(strip_at, b"\0") + bytes(2 * pixels)


def packet(kind, body=b""):
    return struct.pack("<II", 8 + len(body), kind) + body


def string(text):
    return bytes([len(text) + 1]) + (text + "\0").encode("utf-16-le") if text else b"\0"


def codes(*values):
    return struct.pack(f"<I{len(values)}H", len(values), *values)


class CameraPeer:
    """One camera for `TcpPeer`. Exposures are finished when the rig's clock gets there.

    Scripts: `busy` operations to answer Device Busy, `strikes` for the objects to come, `mute` operations to obey
    without an answer, `events` off to lose them.
    """

    def __init__(self, clock, *, serial="VC-0000", terminates=True):
        self.clock = clock
        self.serial = serial
        self.terminates = terminates
        self.properties = {0x500D: 333, 0x5013: 1, 0x5018: 1, 0x5019: 0}
        self.objects = {}
        self.operations = []
        self.written = []
        self.captures = 0
        self.busy = {}
        self.mute = []
        self.events = True
        self.refuses = False
        self.frames_missing = 0
        self.frame = lambda index, ticks: dng(exposure_ticks=ticks)
        self.strikes = []
        self.response_bytes = 14
        self.speeds = ()  # numerators and denominators, of a camera of Ricoh's
        self.formats = (0x3811,)
        self.asked = []  # formats
        self._handle = 0
        self.ponged = threading.Event()
        self._event_connection = None

    def serve(self, connection):
        while True:
            length, kind = struct.unpack("<II", read_exactly(connection, 8))
            body = read_exactly(connection, length - 8)
            if kind == 1:
                ack = packet(
                    2, struct.pack("<I", 7) + bytes(16) + "cam\0".encode("utf-16-le") + struct.pack("<I", 65536)
                )
                connection.sendall(packet(5, struct.pack("<I", 2)) if self.refuses else ack)
            elif kind == 3:
                assert body == struct.pack("<I", 7), "the connection number of the acknowledgement"
                self._event_connection = connection
                connection.sendall(packet(4))
            elif kind == 6:
                self.transaction(connection, body)
            elif kind == 14:
                self.ponged.set()

    def transaction(self, connection, body):
        phase, code, transaction = struct.unpack_from("<IHI", body)
        parameters = struct.unpack_from(f"<{len(body) // 4 - 2}I", body, 10)
        data = self.data_out(connection, transaction) if phase == 2 else b""
        self.operations.append(code)
        if code in self.mute:
            self.mute.remove(code)
            self.operate(code, transaction, parameters, data)
            return
        if self.busy.get(code, 0):
            self.busy[code] -= 1
            connection.sendall(packet(7, struct.pack("<HI", BUSY, transaction)))
            return
        answer = self.operate(code, transaction, parameters, data)
        if answer is not None:
            connection.sendall(packet(9, struct.pack("<IQ", transaction, len(answer))))
            half = len(answer) // 2
            connection.sendall(packet(10, struct.pack("<I", transaction) + answer[:half]))
            connection.sendall(packet(12, struct.pack("<I", transaction) + answer[half:]))
        response = packet(7, struct.pack("<HI", OK, transaction))
        # Reset before sending: the driver, and then the test, go on as soon as the bytes are there.
        length, self.response_bytes = self.response_bytes, 14
        connection.sendall(response[:length])

    def data_out(self, connection, transaction):
        length, kind = struct.unpack("<II", read_exactly(connection, 8))
        start = read_exactly(connection, length - 8)
        assert (kind, struct.unpack("<IQ", start)[0]) == (9, transaction)
        length, kind = struct.unpack("<II", read_exactly(connection, 8))
        end = read_exactly(connection, length - 8)
        assert kind == 12
        assert len(end) - 4 == struct.unpack("<IQ", start)[1]
        return end[4:]

    def operate(self, code, transaction, parameters, data):
        if code == 0x1001:
            return self.device_info()
        if code == 0x1007:
            return struct.pack(f"<I{len(self.objects)}I", len(self.objects), *self.objects)
        if code == 0x1009:
            strike = self.strikes.pop(0) if self.strikes else lambda file: file
            return strike(self.objects[parameters[0]])
        if code == 0x100B:
            del self.objects[parameters[0]]
        if code == 0x100E:
            self.asked.append(parameters[1])
            self.capture(transaction)
        if code == 0x1014 and parameters == (0xD00F,):
            values = [bottom << 32 | top for top, bottom in self.speeds]
            return struct.pack(f"<HHBQQBH{len(values)}Q", 0xD00F, 8, 1, 0, 0, 2, len(values), *values)
        if code == 0x1014:
            assert parameters == (0x500D,)
            return struct.pack("<HHBIIBIII", 0x500D, 6, 1, 333, self.properties[0x500D], 1, 1, 600_000, 1)
        if code == 0x1016:
            self.properties[parameters[0]] = int.from_bytes(data, "little")
            self.written.append((parameters[0], len(data), self.properties[parameters[0]]))
        return None

    def device_info(self):
        operations = [0x1001, 0x1002, 0x1007, 0x1009, 0x100B, 0x100E, 0x1014, 0x1016, *([0x1018] * self.terminates)]
        head = struct.pack("<HIH", 100, 6 if self.speeds else 0, 0) + string("") + struct.pack("<H", 0)
        properties = codes(0xD00F if self.speeds else 0x500D)
        lists = codes(*operations) + codes(0x4002, 0x400D) + properties + codes(*self.formats) + codes(*self.formats)
        return head + lists + string("Virtual") + string("VC") + string("1.0") + string(self.serial)

    def capture(self, transaction):
        self.captures += 1
        burst = self.properties[0x5013] == 2
        frames = (self.properties[0x5018] if burst else 1) - self.frames_missing
        ticks = self.properties[0x500D]
        for index in range(frames):
            end_s = self.clock.now_s() + index * self.properties[0x5019] / 1000 + ticks / 10_000 + 0.02
            self.clock.at(end_s, lambda index=index: self.store(index, ticks, transaction))
        complete_s = self.clock.now_s() + (frames - 1) * self.properties[0x5019] / 1000 + ticks / 10_000 + 0.03
        self.clock.at(complete_s, lambda: self.send_event(struct.pack("<HI", 0x400D, transaction)))

    def store(self, index, ticks, transaction):
        self._handle += 1
        self.objects[self._handle] = self.frame(index, ticks)
        self.send_event(struct.pack("<HII", 0x4002, transaction, self._handle))

    def send_event(self, body):
        if self.events:
            self._event_connection.sendall(packet(8, body))

    def probe(self):
        """Ask over the event connection whether the rig is alive; `ponged` tells that it answered."""
        self._event_connection.sendall(packet(13))
