"""PTP cameras: seconds above, properties below. Every frame is checked to be of this camera and this exposure."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from math import ceil

from rig.config import CameraConfig
from rig.devices import FileFormat, RawFrame
from rig.drivers.clock import RigClock
from rig.drivers.frame_file import read_facts
from rig.drivers.ptp_connection import PtpConnection, ResponseError
from rig.drivers.shutter import Shutter, TickShutter, shutter_of
from rig.errors import DeviceError, FrameCheckError, FrameError, LimitError, ReadTimeoutError, StateError
from rig.protocols import ptp
from rig.protocols.ptp import CaptureMode, DeviceInfo, Event, ObjectFormat, Operation, Property, PropertyDesc, Response

_MS_PER_S = 1000
_BUSY_POLL_S = 0.1
_BUSY_MAX_S = 5.0
_EVENT_POLL_S = 0.01
_LATE_S = 5.0  # beyond exposure and intervals: shutter lag, readout, writing to the card
_DOWNLOADS = 3  # attempts per frame: the file stays on the card until it is deleted
_DOWNLOAD_TIMEOUT_S = 30.0  # for one packet
_COUNT_MAX = 0xFFFF  # of a burst's frames, and of the milliseconds between them
_EXPOSURE_TOLERANCE = 0.02  # cameras round their shutter times
_NO_TRANSACTION = (0, 0xFFFFFFFF)


@dataclass(frozen=True, slots=True)
class _Exposure:
    """Exposures under way."""

    exposure_s: float
    file_format: FileFormat
    frames: int
    interval_s: float
    taken_s: float
    transaction: int

    @property
    def end_s(self) -> float:
        return self.taken_s + (self.frames - 1) * self.interval_s + self.exposure_s


class PtpCamera:
    """One camera. After `open` it is known to be the one that rig.toml means."""

    def __init__(self, name: str, config: CameraConfig, clock: RigClock) -> None:
        """Nothing is opened yet."""
        self._name = name
        self._config = config
        self._clock = clock
        self._connection = PtpConnection(name, config.address, clock)
        self._properties: dict[Property, int] = {}
        self._shutter: Shutter = TickShutter()
        self._formats: frozenset[int] = frozenset()  # of what it captures
        self._can_terminate = False
        self._foreign: frozenset[int] = frozenset()  # objects that were on the card before us
        self._exposure: _Exposure | None = None
        self._littered = False  # frames of ours may be on the card that nobody waits for
        self._stray = False

    @property
    def name(self) -> str:
        """Key in rig.toml, [cameras.NAME]."""
        return self._name

    def open(self) -> None:
        """Connect and check who is there. Raises ConnectError, and DeviceError where it is another camera.

        All that is on the card by then counts as somebody else's, also what is left of ours after a lost connection: a
        handle names the same object only as long as the PTP session lasts (ISO 15740, "ObjectHandles").
        """
        try:
            self._set_up(self._connection.open())
        except BaseException:
            self._connection.close()
            raise

    def expose(
        self,
        exposure_s: float,
        *,
        frames: int = 1,
        interval_s: float = 0.0,
        file_format: FileFormat = FileFormat.RAW,
    ) -> None:
        """Start one exposure, or a burst with that interval between starts, and return.

        The exposure is rounded to 0.1 ms or is one of the camera's shutter speeds, the interval is rounded to 1 ms and
        not below the exposure, which the frames' times take into account. Raises LimitError before anything is exposed,
        StateError where the frames before were not fetched.
        """
        value, interval_ms = self._settings(exposure_s, frames, interval_s)
        format_code = self._format_code(file_format)
        if self._exposure is not None:
            raise StateError(f"{self._name}: exposures are under way; fetch or abort them before the next.")
        if not self._connection.is_open:
            self.open()
        self._tidy()
        self._set(self._shutter.code, value)
        self._set(Property.STILL_CAPTURE_MODE, CaptureMode.BURST if frames > 1 else CaptureMode.NORMAL)
        if frames > 1:
            self._set(Property.BURST_NUMBER, frames)
            self._set(Property.BURST_INTERVAL, interval_ms)
        self._connection.events()
        self._littered = True
        self._patiently(Operation.INITIATE_CAPTURE, 0, format_code)
        taken_s, transaction = self._clock.now_s(), self._connection.last_transaction
        self._exposure = _Exposure(
            self._shutter.seconds(value), file_format, frames, interval_ms / _MS_PER_S, taken_s, transaction
        )

    def fetch(self) -> Sequence[RawFrame]:
        """Wait for the exposures started last and download their frames, in order.

        Raises ReadTimeoutError where a frame does not come, FrameCheckError where its serial number or exposure is not
        the one asked for, or where the file is cut; StateError where nothing was exposed.
        """
        exposure, self._exposure = self._exposure, None
        if exposure is None:
            raise StateError(f"{self._name}: nothing was exposed; there is nothing to fetch.")
        self._stray = False
        handles = self._await_objects(exposure)
        downloads = [self._download(handle, index, exposure) for index, handle in enumerate(handles)]
        self._littered = self._stray
        return _timed(downloads)

    def abort(self) -> None:
        """Drop what is under way; frames that were exposed already are deleted before the next exposure."""
        if self._exposure is None:
            return
        self._exposure = None
        if self._connection.is_open and self._can_terminate:
            with suppress(ResponseError):  # nothing is open: the exposures ended by themselves
                self._connection.transact(Operation.TERMINATE_OPEN_CAPTURE, 0)

    def transfer_time_s(self, frames: int) -> float:
        """Forecast of the download."""
        return frames * self._config.frame_megabytes / self._config.megabytes_per_s

    def close(self) -> None:
        """Hang up; closing twice is allowed."""
        self._connection.close()

    def _set_up(self, info: DeviceInfo) -> None:
        if info.serial != self._config.serial:
            raise DeviceError(
                f"{self._name}: expected serial {self._config.serial}, found {info.serial} at {self._config.address}: "
                "the cable is in another port, or the address in rig.toml is another camera's."
            )
        self._properties = {}
        self._can_terminate = Operation.TERMINATE_OPEN_CAPTURE in info.operations
        self._formats = frozenset(info.capture_formats)
        self._shutter = shutter_of(info, self._describe)
        self._foreign = frozenset(self._objects())

    def _settings(self, exposure_s: float, frames: int, interval_s: float) -> tuple[int, int]:
        """The shutter's value and milliseconds. Raises LimitError."""
        value = self._shutter.value(self._name, exposure_s)
        if not 1 <= frames <= _COUNT_MAX or (frames > 1 and not exposure_s <= interval_s <= _COUNT_MAX / _MS_PER_S):
            raise LimitError(
                f"{self._name}: {frames} frames every {interval_s:g} s of {exposure_s:g} s each cannot be: 1 to 65535 "
                "frames, an interval of at least the exposure and at most 65.5 s; nothing was exposed."
            )
        return value, max(round(interval_s * _MS_PER_S), ceil(exposure_s * _MS_PER_S))

    def _format_code(self, file_format: FileFormat) -> ObjectFormat:
        """What to ask for; a camera without JPEG is not told, as its raw files may have a format of their own.

        Raises LimitError.
        """
        if ObjectFormat.JPEG in self._formats:
            return ObjectFormat.JPEG if file_format is FileFormat.JPEG else ObjectFormat.DNG
        if file_format is FileFormat.JPEG:
            raise LimitError(f"{self._name}: delivers no JPEG; nothing was exposed.")
        return ObjectFormat.ANY

    def _describe(self, code: Property) -> PropertyDesc:
        return ptp.decode_property_desc(self._connection.transact(Operation.GET_PROPERTY_DESC, code))

    def _set(self, code: Property, value: int) -> None:
        """Set a property that has another value, or one that is not known yet."""
        if self._properties.get(code) == value:
            return
        self._properties.pop(code, None)
        self._patiently(Operation.SET_PROPERTY_VALUE, code, data=ptp.encode_value(ptp.PROPERTY_TYPES[code], value))
        self._properties[code] = value

    def _patiently(self, operation: Operation, *parameters: int, data: bytes | None = None) -> None:
        """Carry out an operation, again while the camera says that it is busy. Raises DeviceError where it stays so."""
        deadline_s = self._clock.now_s() + _BUSY_MAX_S
        while True:
            try:
                self._connection.transact(operation, *parameters, data=data)
            except ResponseError as error:
                if error.code != Response.DEVICE_BUSY:
                    raise
                if self._clock.now_s() > deadline_s:
                    raise DeviceError(
                        f"{self._name}: stays busy for {_BUSY_MAX_S:g} s. Switch it off and on. ({error})"
                    ) from error
                self._clock.sleep(_BUSY_POLL_S)
            else:
                return

    def _await_objects(self, exposure: _Exposure) -> list[int]:
        """Handles of all frames in the order in which they came; lost events are made up for by the card's contents."""
        self._sleep_until(exposure.end_s)
        handles: list[int] = []
        while True:
            complete = False
            for code, parameters in self._news(exposure):
                handles += [handle for handle in parameters if code == Event.OBJECT_ADDED and handle not in handles]
                complete |= code == Event.CAPTURE_COMPLETE
            if len(handles) >= exposure.frames:
                return handles[: exposure.frames]
            if complete or self._clock.now_s() > exposure.end_s + _LATE_S:
                return self._from_card(exposure)
            self._clock.sleep(_EVENT_POLL_S)

    def _news(self, exposure: _Exposure) -> Iterator[tuple[int, tuple[int, ...]]]:
        for event in self._connection.events():
            if event.transaction in (exposure.transaction, *_NO_TRANSACTION):
                yield event.code, event.parameters[:1]
            else:
                self._stray = True  # of an exposure whose start went unconfirmed

    def _from_card(self, exposure: _Exposure) -> list[int]:
        handles = sorted(set(self._objects()) - self._foreign)
        if len(handles) != exposure.frames:
            raise ReadTimeoutError(
                f"{self._name}: {len(handles)} of {exposure.frames} frames came within {_LATE_S:g} s after the "
                f"exposure of {exposure.exposure_s:g} s. The step will have to be taken again."
            )
        return handles

    def _download(self, handle: int, index: int, exposure: _Exposure) -> tuple[RawFrame, float | None]:
        for attempts_left in reversed(range(_DOWNLOADS)):
            try:
                frame = self._get(handle, index, exposure)
            except (FrameError, FrameCheckError):
                if not attempts_left:
                    raise
            else:
                break
        self._connection.transact(Operation.DELETE_OBJECT, handle)
        return frame

    def _get(self, handle: int, index: int, exposure: _Exposure) -> tuple[RawFrame, float | None]:
        """A frame with the time at which it was due, and the one that the camera stamped on it."""
        data = self._connection.transact(Operation.GET_OBJECT, handle, timeout_s=_DOWNLOAD_TIMEOUT_S)
        facts = read_facts(self._name, data)
        if facts.serial != self._config.serial:
            raise FrameCheckError(
                f"{self._name}: expected serial {self._config.serial}, frame carries {facts.serial}: the cable is in "
                "another port. The step will have to be taken again."
            )
        if facts.file_format is not exposure.file_format:
            raise FrameCheckError(
                f"{self._name}: asked for .{exposure.file_format}, a .{facts.file_format} came: the camera's own "
                "setting is in the way. The step will have to be taken again."
            )
        if abs(facts.exposure_s - exposure.exposure_s) > max(
            _EXPOSURE_TOLERANCE * exposure.exposure_s, self._shutter.rounding_s
        ):
            raise FrameCheckError(
                f"{self._name}: asked for {exposure.exposure_s:g} s, frame carries {facts.exposure_s:g} s: the shutter "
                "or the camera's own dial is in the way. The step will have to be taken again."
            )
        taken_s = exposure.taken_s + index * exposure.interval_s
        frame = RawFrame(self._name, facts.serial, data, facts.exposure_s, index, taken_s, facts.iso, facts.file_format)
        return frame, facts.stamp_s

    def _objects(self) -> tuple[int, ...]:
        return ptp.decode_u32_array(self._connection.transact(Operation.GET_OBJECT_HANDLES, ptp.ANY, 0, ptp.ANY))

    def _tidy(self) -> None:
        """Delete our own frames that an abort or a failure left on the card."""
        if self._littered:
            for handle in sorted(set(self._objects()) - self._foreign):
                self._connection.transact(Operation.DELETE_OBJECT, handle)
            self._littered = False

    def _sleep_until(self, moment_s: float) -> None:
        self._clock.sleep(max(0.0, moment_s - self._clock.now_s()))


def _timed(downloads: Sequence[tuple[RawFrame, float | None]]) -> list[RawFrame]:
    """The frames of a burst as far apart as the camera's clock says; as they were due where it says nothing usable."""
    frames, stamps_s = [frame for frame, _ in downloads], [stamp for _, stamp in downloads if stamp is not None]
    if len(stamps_s) < len(frames) or any(after <= before for before, after in pairwise(stamps_s)):
        return frames
    begun_s = frames[0].taken_s - stamps_s[0]
    return [replace(frame, taken_s=begun_s + stamp) for frame, stamp in zip(frames, stamps_s, strict=True)]
