"""Frames on disk: whole and durable, or not there.

A file or array is written beside its place under a hidden name, synchronised, renamed into place, and the directory is
synchronised. A crash leaves either nothing under the final name or all of it; hidden leftovers are swept away when the
session is taken up again.
"""

import errno
import hashlib
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.codecs import BloscCodec

from rig.errors import DiskFullError, MissingFrameError, StoreError

PART_PREFIX = ".part-"
_CHUNK = (8, 64, 64)  # 64 KiB: one image reads 8 frames' worth, one pixel over time 64 x 64 pixels' worth
_SHARD_PX = 256  # one file holds 256 x 256 pixels of the whole sweep: tens of files, not thousands
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@dataclass(frozen=True, slots=True)
class Stored:
    """What was made durable: hex digest of the file's bytes, or of the array's in C order; size on disk."""

    sha256: str
    bytes: int


def write_file(path: Path, data: bytes) -> Stored:
    """Make one file durable. Raises DiskFullError or StoreError; then nothing is left under the name."""

    def write(part: Path) -> None:
        with part.open("xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())

    _place(path, write)
    return Stored(hashlib.sha256(data).hexdigest(), len(data))


def write_burst(path: Path, raw_dn: NDArray[np.uint16], attributes: Mapping[str, Any]) -> Stored:
    """Make a burst `raw_dn` (time, row, column) durable as one compressed Zarr array, with these attributes.

    Raises DiskFullError or StoreError; then nothing is left under the name.
    """

    def write(part: Path) -> None:
        chunks = tuple(min(chunk, max(size, 1)) for chunk, size in zip(_CHUNK, raw_dn.shape, strict=True))
        extent = (raw_dn.shape[0], min(_SHARD_PX, raw_dn.shape[1]), min(_SHARD_PX, raw_dn.shape[2]))
        shards = tuple(-(-size // chunk) * chunk for size, chunk in zip(extent, chunks, strict=True))
        codec = BloscCodec(cname="zstd", clevel=1, shuffle="bitshuffle")
        array = zarr.create_array(
            part, shape=raw_dn.shape, dtype=raw_dn.dtype, chunks=chunks, shards=shards, compressors=codec,
            attributes=dict(attributes), dimension_names=("time", "row", "column"),
        )  # fmt: skip
        array[:] = raw_dn
        for folder, _, names in os.walk(part):
            for name in names:
                _sync(Path(folder, name))
            _sync(Path(folder))

    _place(path, write)
    return Stored(_array_sha256(raw_dn), _size(path))


def publish(part: Path, path: Path) -> None:
    """Give a finished directory its name, durably. Raises OSError where something other than an empty one has it."""
    part.rename(path)
    _sync(path.parent)


def check_present(path: Path, size: int) -> None:
    """Raises MissingFrameError where the file or array is not there or has another size; reads no content."""
    if not path.exists():
        raise MissingFrameError(f"{path}: the journal names this frame, but it is missing.")
    if _size(path) != size:
        raise MissingFrameError(f"{path}: {_size(path)} bytes where the journal says {size}; truncated or changed.")


def check_content(path: Path, sha256: str) -> None:
    """Raises MissingFrameError where the content is not what was stored."""
    try:
        found = _burst_sha256(path) if path.is_dir() else hashlib.sha256(path.read_bytes()).hexdigest()
    except (OSError, ValueError, KeyError, RuntimeError) as error:
        raise MissingFrameError(f"{path}: cannot be read: {error}.") from error
    if found != sha256:
        raise MissingFrameError(f"{path}: the content has changed: its checksum is not the journal's.")


def sweep_away_parts(folder: Path) -> None:
    """Remove what a crash left half written."""
    for part in sorted(folder.rglob(f"{PART_PREFIX}*")):
        _remove(part)


@contextmanager
def reported(path: Path) -> Iterator[None]:
    """Turn the system's errors into DiskFullError or StoreError that name the path."""
    try:
        yield
    except OSError as error:
        if error.errno in _FULL:
            raise DiskFullError(f"{path}: the disk is full; the step stays open. Make room and resume.") from error
        raise StoreError(f"{path}: cannot be written: {error.strerror or error}.") from error


def _place(path: Path, write: Callable[[Path], None]) -> None:
    part = path.with_name(PART_PREFIX + path.name)
    with reported(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            _remove(part)
            write(part)
            if path.is_dir():  # of an earlier attempt that the journal does not count; a rename cannot replace it
                _remove(path)
            part.rename(path)
            _sync(path.parent)
            _sync(path.parent.parent)
        except BaseException:
            _remove(part)
            raise


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _size(path: Path) -> int:
    if path.is_dir():
        return sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
    return path.stat().st_size


def _array_sha256(raw_dn: NDArray[np.uint16]) -> str:
    return hashlib.sha256(np.ascontiguousarray(raw_dn, dtype="<u2").data).hexdigest()


def _burst_sha256(path: Path) -> str:
    """The digest of `write_burst`, with no more than one chunk's depth of frames in memory."""
    array = zarr.open_array(path, mode="r")
    digest = hashlib.sha256()
    for start in range(0, array.shape[0], _CHUNK[0]):
        block = np.asarray(array[start : start + _CHUNK[0]], dtype="<u2")
        digest.update(np.ascontiguousarray(block).data)
    return digest.hexdigest()
