"""Shards of an array store, decoded in one go.

Asking Zarr for each chunk takes as long again as its decompression, and its threads wait for each other. The layout is
that of the `sharding_indexed` codec (Zarr v3): chunks compressed by Zstandard, then offset and size of each, then a
checksum.
"""

from itertools import product
from math import ceil
from pathlib import Path

import numpy as np
from numcodecs.zstd import Zstd

from processing.errors import ImageError
from processing.products.arrays import Float32

_CHECKSUM = 4
_NO_CHUNK = 2**64 - 1


def read_shard(path: Path, chunk: tuple[int, ...], height: int, first: int, out: Float32) -> None:
    """Fill `out` (light, view, rows, x, channel) with rows of a float16 shard from `first`, where a chunk begins.

    `chunk` are the lengths of a chunk, `height` those of the shard's y; NaN where shard or chunk is missing.
    Raises ImageError for a file that is no such shard.
    """
    grid = ceil(height / chunk[2]), ceil(out.shape[3] / chunk[3])
    zstd = Zstd()
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
                values = np.frombuffer(zstd.decode(shard[start : start + size]), "<f2").reshape(chunk)
                part[...] = values[tuple(slice(n) for n in part.shape)]
    except FileNotFoundError:
        out[...] = np.nan
    except (ValueError, RuntimeError) as error:
        raise ImageError(f"{path}: not a whole shard ({error}); process the session again") from error
