"""One holder at a time: of a rig, and of a session folder. The lock dies with its process, however that dies."""

import fcntl
import hashlib
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from rig.config import RigConfig
from rig.errors import BusyError, StoreError


@contextmanager
def hold_rig(config: RigConfig) -> Iterator[None]:
    """Hold the rig with this axis bus; taken before its devices are opened. Raises BusyError where another holds it."""
    port = config.bus.port if "://" in config.bus.port else str(Path(config.bus.port).resolve())
    name = hashlib.sha256(port.encode()).hexdigest()[:16]
    with hold(Path(tempfile.gettempdir(), f"appearance-rig-{name}.lock"), f"the rig {config.name!r}"):
        yield


@contextmanager
def hold(path: Path, what: str) -> Iterator[None]:
    """Hold a lock file. Raises BusyError that names the other holder's process."""
    handle = _open(path)
    try:
        if not _locked(handle, fcntl.LOCK_EX):
            holder = os.pread(handle, 20, 0).decode(errors="replace") or "unknown"
            raise BusyError(f"{what} is in use by process {holder}. Wait for it to end, or stop it.")
        with suppress(OSError):  # a full disk: the number is for the message only
            os.ftruncate(handle, 0)
            os.pwrite(handle, str(os.getpid()).encode(), 0)
        yield
    finally:
        os.close(handle)


def is_held(path: Path) -> bool:
    """Whether a living process holds this lock file."""
    handle = _open(path)
    try:
        return not _locked(handle, fcntl.LOCK_SH)
    finally:
        os.close(handle)


def _open(path: Path) -> int:
    try:
        return os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
    except OSError as error:
        raise StoreError(f"{path}: cannot be locked: {error.strerror}.") from error


def _locked(handle: int, how: int) -> bool:
    try:
        fcntl.flock(handle, how | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
