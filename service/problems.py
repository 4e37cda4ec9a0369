"""One table from exception class to what a person or a program is told: HTTP status, stable code, exit code."""

import errno
import os
from dataclasses import dataclass

from processing.errors import CalibrationError, ImageError, ProcessingError
from render.errors import GlUnavailableError, RenderError
from rig.errors import (
    BusyError,
    ConfigError,
    ConnectError,
    DeviceError,
    DiskFullError,
    FrameCheckError,
    InterlockError,
    LimitError,
    MissingFrameError,
    PlanError,
    ProtocolError,
    ReadTimeoutError,
    RigError,
    StateError,
    StoreError,
    TransportError,
    UnknownDeviceError,
)

EXIT_CODES = {
    0: "done",
    1: "a defect of this program: please report it",
    2: "the input is wrong: option, file, plan or image; nothing was moved",
    3: "a device or its wire failed; the rig was made safe, the session can be resumed",
    4: "busy, or not possible in this state",
    5: "storage: disk full, frame missing, session or file unusable",
    130: "interrupted; the rig was made safe, the session can be resumed",
}


@dataclass(frozen=True, slots=True)
class Problem:
    """How one class of errors is reported."""

    status: int
    code: str
    exit_code: int


class NotFoundError(Exception):
    """An address of the REST service that names nothing: no such session, job, frame or product."""


# The nearest class in the error's own ancestry decides, so that a new subclass is reported like its parent.
PROBLEMS: dict[type[Exception], Problem] = {
    NotFoundError: Problem(404, "not-found", 2),
    UnknownDeviceError: Problem(404, "unknown-device", 2),
    LimitError: Problem(422, "out-of-range", 2),
    InterlockError: Problem(422, "interlock", 2),
    PlanError: Problem(422, "impossible-plan", 2),
    ConfigError: Problem(422, "malformed-config", 2),
    ConnectError: Problem(503, "cannot-connect", 3),
    ReadTimeoutError: Problem(504, "device-timeout", 3),
    TransportError: Problem(502, "wire-failed", 3),
    ProtocolError: Problem(502, "wrong-bytes", 3),
    FrameCheckError: Problem(502, "wrong-frame", 3),
    DeviceError: Problem(502, "device-failed", 3),
    StateError: Problem(409, "wrong-state", 4),
    BusyError: Problem(409, "busy", 4),
    DiskFullError: Problem(507, "disk-full", 5),
    MissingFrameError: Problem(500, "missing-frame", 5),
    StoreError: Problem(500, "session-unreadable", 5),
    ImageError: Problem(422, "unusable-image", 2),
    CalibrationError: Problem(422, "cannot-calibrate", 2),
    GlUnavailableError: Problem(503, "no-opengl", 3),
    RenderError: Problem(422, "cannot-draw", 2),
    ProcessingError: Problem(422, "cannot-process", 2),
    RigError: Problem(500, "rig-failed", 3),
}


UNUSABLE_FILE = Problem(500, "unusable-file", 5)  # a path that cannot be opened, made or written
DEFECT = Problem(500, "defect", 1)
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def problem_of(error: BaseException) -> Problem | None:
    """The problem that reports this error; None for what is a defect and not a problem of the user's."""
    if _is_full(error):
        return PROBLEMS[DiskFullError]
    if isinstance(error, OSError) and error.filename is not None:
        return UNUSABLE_FILE
    return next((PROBLEMS[kind] for kind in type(error).__mro__ if kind in PROBLEMS), None)


def _is_full(error: BaseException) -> bool:
    """Whether a full disk is at the bottom of it; OpenEXR passes the system's text on and not its number."""
    if isinstance(error, OSError) and error.errno in _FULL:
        return True
    if error.__cause__ is None:
        return os.strerror(errno.ENOSPC) in str(error)
    return _is_full(error.__cause__)
