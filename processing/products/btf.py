"""The measured bidirectional texture function and its store on disk."""

import math
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from processing.errors import ImageError
from processing.products.arrays import Float32, Float64
from processing.products.provenance import Provenance, read_arrays, read_description, write_description
from processing.products.shards import CODING, is_readable, read_shard

KIND = "btf"
_STORE = "btf.zarr"
# A chunk of 8 x 8 direction pairs by 16 x 16 texels is 96 KiB; a shard holds all texels of its direction pairs. One
# image opens one file and reads 64 times its size; one texel reads 256 times its size in one chunk per file.
_DIRECTIONS_PER_CHUNK = 8
_TEXELS_PER_CHUNK = 16
_LARGEST_HALF = 65504.0
_BLOCK = 1 << 22  # samples that are read at once, unless a row of chunks under 8 lights holds more

_READERS = 1  # the other core works on the block before

Block = tuple[slice, slice, Float32]


@dataclass(frozen=True, eq=False)
class Btf:
    """Reflectance (light, view, y, x, channel) float32 in 1/sr, without the cosine; NaN = not measured.

    Directions are unit vectors (n, 3) of the sample frame. Row 0 of the texels is at +Y.
    """

    reflectance: Float32
    light_directions: Float64
    view_directions: Float64
    provenance: Provenance = field(default_factory=Provenance)

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of light, view, y, x, channel."""
        return self.reflectance.shape

    def rows(self, rows: slice) -> Float32:
        """Texel rows under every light and view, (light, view, rows, x, channel)."""
        return self.reflectance[:, :, rows]

    def blocks(self) -> Iterator[Block]:
        """Lights, rows, and what all views see of them, (light, view, row, x, channel); each sample once."""
        yield slice(0, self.shape[0]), slice(0, self.shape[2]), self.reflectance

    def seen_from(self, view: int) -> Float32:
        """What one view sees under every light, (light, y, x, channel)."""
        return self.reflectance[:, view]

    def row_spans(self) -> Iterator[slice]:
        """Spans of rows that keep a block small beside the whole."""
        return _spans(self.shape[2], _TEXELS_PER_CHUNK)

    def save(self, folder: Path) -> None:
        """Write btf.zarr (float16, Zarr v3, sharded), directions.npz and product.json into `folder`.

        Raises ImageError for a value beyond the range of float16.
        """
        folder.mkdir(parents=True, exist_ok=True)
        if np.nanmax(np.abs(self.reflectance), initial=0.0) > _LARGEST_HALF:
            raise ImageError(f"{folder}: a reflectance lies beyond {_LARGEST_HALF:g}, which float16 cannot hold")
        write_blocks(folder, self.shape, lambda lights, views: self.reflectance[lights, views])
        describe(folder, (self.light_directions, self.view_directions), self.provenance)

    @classmethod
    def load(cls, folder: Path) -> "Btf":
        """Read all of it into memory; raises ImageError where the folder holds something else."""
        stored = StoredBtf.open(folder)
        blocks = [stored.rows(rows) for rows in stored.row_spans()]
        return cls(np.concatenate(blocks, axis=2), stored.light_directions, stored.view_directions, stored.provenance)


@dataclass(frozen=True, eq=False)
class StoredBtf:
    """A BTF left on disk: images, texels and blocks of rows are read when asked for, as float32."""

    array: Any
    light_directions: Float64
    view_directions: Float64
    provenance: Provenance

    @classmethod
    def open(cls, folder: Path) -> "StoredBtf":
        """Open for reading; raises ImageError where the folder holds something else."""
        content, provenance = read_description(folder, KIND)
        light, view = read_arrays(folder / content["directions"], ("light", "view"))
        try:
            array = zarr.open_array(store=folder / content["store"], mode="r")
        except (OSError, ValueError, KeyError, zarr.errors.BaseZarrError) as error:
            raise ImageError(f"{folder / content['store']}: not an array store; process the session again") from error
        return cls(array, light, view, provenance)

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of light, view, y, x, channel."""
        return tuple(self.array.shape)

    def image(self, light: int, view: int) -> Float32:
        """What one view sees under one light, (y, x, channel)."""
        return np.asarray(self.array[light, view], np.float32)

    def seen_from(self, view: int) -> Float32:
        """What one view sees under every light, (light, y, x, channel)."""
        return np.asarray(self.array[:, view], np.float32)

    def texel(self, y: int, x: int) -> Float32:
        """One texel under every light and view, (light, view, channel)."""
        return np.asarray(self.array[:, :, y, x], np.float32)

    def rows(self, rows: slice) -> Float32:
        """Texel rows under every light and view, (light, view, rows, x, channel)."""
        return np.asarray(self.array[:, :, rows], np.float32)

    def row_spans(self) -> Iterator[slice]:
        """Spans of rows that follow the chunks, so that each chunk is read once."""
        return _spans(self.shape[2], self.array.chunks[2])

    def blocks(self) -> Iterator[Block]:
        """As `Btf.blocks`, of few lights and rows, each good until the next is asked for, which is read meanwhile."""
        spans = list(self._block_spans())
        room = np.empty((2, max(math.prod(self._lengths(*span)) for span in spans)), np.float32)
        with ThreadPoolExecutor(_READERS) as pool:
            reading = self._begin(pool, *spans[0], room[0])
            for number, span in enumerate(spans[1:], start=1):
                block = reading.done()
                reading = self._begin(pool, *span, room[number % 2])
                yield block
            yield reading.done()

    def _block_spans(self) -> Iterator[tuple[slice, slice]]:
        per_row = self.array.chunks[0] * math.prod(self.shape[i] for i in (1, 3, 4))
        height = self.array.chunks[2]
        rows = list(_spans(self.shape[2], max(_BLOCK // (per_row * height), 1) * height))
        return ((lights, span) for lights in _spans(self.shape[0], self.array.chunks[0]) for span in rows)

    def _lengths(self, lights: slice, rows: slice) -> tuple[int, ...]:
        return lights.stop - lights.start, self.shape[1], rows.stop - rows.start, *self.shape[3:]

    def _begin(self, pool: ThreadPoolExecutor, lights: slice, rows: slice, room: Float32) -> "_Reading":
        lengths = self._lengths(lights, rows)
        block, shards = room[: math.prod(lengths)].reshape(lengths), _spans(self.shape[1], self.array.chunks[1])
        parts = [pool.submit(self._read, lights, views, rows, block[:, views]) for views in shards]
        return _Reading(lights, rows, block, parts)

    def _read(self, lights: slice, views: slice, rows: slice, out: Float32) -> None:
        """Fill `out` with the directions of one shard."""
        if not is_readable(self.array.metadata.codecs):
            out[...] = self.array[lights, views, rows]
            return
        chunk = self.array.chunks
        key = self.array.metadata.encode_chunk_key((lights.start // chunk[0], views.start // chunk[1], 0, 0, 0))
        read_shard(self.array.store.root / key, chunk, self.shape[2], rows.start, out)


@dataclass(frozen=True, eq=False)
class _Reading:
    """A block that threads are filling."""

    lights: slice
    rows: slice
    block: Float32
    parts: list[Future[None]]

    def done(self) -> Block:
        """The block when all of it is there."""
        for part in self.parts:
            part.result()
        return self.lights, self.rows, self.block


def write_blocks(folder: Path, shape: tuple[int, ...], block: Callable[[slice, slice], Float32]) -> None:
    """Write btf.zarr from blocks that are asked for one after another, so that a BTF need not fit into memory.

    `block(lights, views)` is (light, view, y, x, channel) for at most 8 lights and 8 views. `describe` makes the folder
    a product.
    """
    chunks = _chunks(shape)
    shards = (*chunks[:2], *(math.ceil(n / c) * c for n, c in zip(shape[2:], chunks[2:], strict=True)))
    store: Any = zarr.create_array(
        store=folder / _STORE, shape=shape, chunks=chunks, shards=shards, dtype="float16", overwrite=True, **CODING,
        fill_value=math.nan,  # a shard that got lost is not measured, not black
    )  # fmt: skip
    for lights in _spans(shape[0], chunks[0]):
        for views in _spans(shape[1], chunks[1]):
            store[lights, views] = block(lights, views).astype(np.float16)


def describe(folder: Path, directions: tuple[Float64, Float64], provenance: Provenance) -> None:
    """Write the directions to the lights and to the views, and product.json, beside btf.zarr."""
    np.savez(folder / "directions.npz", light=directions[0], view=directions[1])
    content = {"store": _STORE, "directions": "directions.npz", "axes": "light view y x channel"}
    write_description(folder, KIND, content, provenance)


def _chunks(shape: tuple[int, ...]) -> tuple[int, ...]:
    limits = (_DIRECTIONS_PER_CHUNK, _DIRECTIONS_PER_CHUNK, _TEXELS_PER_CHUNK, _TEXELS_PER_CHUNK, shape[4])
    return tuple(min(n, limit) for n, limit in zip(shape, limits, strict=True))


def _spans(length: int, step: int) -> Iterator[slice]:
    return (slice(start, min(start + step, length)) for start in range(0, length, step))
