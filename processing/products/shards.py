"""Shards of an array store, decoded in one go.

Asking Zarr for each chunk takes as long again as its decompression, and its threads wait for each other. The layout is
that of the `sharding_indexed` codec (Zarr v3): chunks, then offset and size of each, then a checksum. A chunk has its
halves as they are, and a checksum: compression saves a fifth of measured ones and takes longer than all else.
"""

from collections.abc import Sequence
from itertools import product
from math import ceil
from pathlib import Path
from typing import Any

import google_crc32c
import numba
import numpy as np
from numpy.typing import NDArray
from zarr.codecs import BytesCodec, Crc32cCodec

from processing.errors import ImageError
from processing.products.arrays import Float32

_BYTES = BytesCodec(endian="little")
_CHECKED = Crc32cCodec()
CODING: dict[str, Any] = {"serializer": _BYTES, "compressors": _CHECKED}  # for `create_array`
_CHECKSUM = 4
_NO_CHUNK = 2**64 - 1
_FLOATS = np.arange(1 << 16, dtype=np.uint16).view(np.float16).astype(np.float32)  # of each half's bits


def is_readable(codecs: Sequence[object]) -> bool:
    """Whether `read_shard` reads an array of these Zarr codecs; older products and those of others are for Zarr."""
    inner = getattr(codecs[0], "codecs", ())
    return [type(codec) for codec in inner] == [type(codec) for codec in (_BYTES, _CHECKED)]


def read_shard(path: Path, chunk: tuple[int, ...], height: int, first: int, out: Float32) -> None:
    """Fill `out` (light, view, rows, x, channel) with rows of a float16 shard from `first`, where a chunk begins.

    `chunk` are the lengths of a chunk, `height` those of the shard's y; NaN where shard or chunk is missing.
    Raises ImageError for a file that is no such shard.
    """
    grid = ceil(height / chunk[2]), ceil(out.shape[3] / chunk[3])
    try:
        shard = np.memmap(path, np.uint8, "r")
        table = shard[len(shard) - _CHECKSUM - 16 * grid[0] * grid[1] : -_CHECKSUM]
        places = np.frombuffer(table.tobytes(), "<u8").reshape(*grid, 2)
        for row, column in product(range(ceil(out.shape[2] / chunk[2])), range(grid[1])):
            part = out[:, :, row * chunk[2] : (row + 1) * chunk[2], column * chunk[3] : (column + 1) * chunk[3]]
            start, size = (int(n) for n in places[first // chunk[2] + row, column])
            if start == _NO_CHUNK:
                part[...] = np.nan
            else:
                _widen(_halves(shard[start : start + size].tobytes()).reshape(chunk), _FLOATS, part)
    except FileNotFoundError:
        out[...] = np.nan
    except (ValueError, RuntimeError) as error:
        raise ImageError(f"{path}: not a whole shard ({error}); process the session again") from error


def _halves(stored: bytes) -> NDArray[np.uint16]:
    """The bits of a chunk's float16 values."""
    values, checksum = stored[:-_CHECKSUM], stored[-_CHECKSUM:]
    if google_crc32c.value(values) != int.from_bytes(checksum, "little"):
        raise ValueError("a chunk differs from its checksum")
    return np.frombuffer(values, "<u2")


@numba.njit(cache=True, nogil=True)
def _widen(halves: NDArray[np.uint16], floats: Float32, out: Float32) -> None:
    """Chunks at the end of an axis are as long as the others; what lies beyond `out` is not looked at."""
    for light in range(out.shape[0]):
        for view in range(out.shape[1]):
            for y in range(out.shape[2]):
                for x in range(out.shape[3]):
                    for channel in range(out.shape[4]):
                        out[light, view, y, x, channel] = floats[halves[light, view, y, x, channel]]
