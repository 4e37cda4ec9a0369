"""Where the samples of a plain TIFF lie, so that they can be used without being read (TIFF revision 6.0, section 2)."""

import mmap
import struct
import sys
from dataclasses import dataclass

_TYPES = {3: "H", 4: "I"}  # SHORT and LONG; a tag of another type is none of those that count here
_WIDTH, _LENGTH, _BITS, _COMPRESSION, _PHOTOMETRIC = 0x100, 0x101, 0x102, 0x103, 0x106
_OFFSETS, _SAMPLES, _ROWS_PER_STRIP, _BYTE_COUNTS = 0x111, 0x115, 0x116, 0x117
_MOSAIC = {_BITS: 16, _COMPRESSION: 1, _PHOTOMETRIC: 32803, _SAMPLES: 1}
_MAGIC = b"II*\0" if sys.byteorder == "little" else b"MM\0*"


@dataclass(frozen=True, slots=True)
class SampleBlock:
    """One block of 16-bit samples (h, w) from byte `start` to the end of the file; `fields` locate tags' values."""

    start: int
    shape: tuple[int, int]
    fields: dict[int, tuple[str, int]]

    @property
    def end(self) -> int:
        """The byte behind the last sample."""
        return self.start + 2 * self.shape[0] * self.shape[1]


def sample_block(content: mmap.mmap | bytes) -> SampleBlock | None:
    """The block of an uncompressed colour mosaic in one strip at the end of the file; None for any other file."""
    if content[:4] != _MAGIC:
        return None
    try:
        fields = _fields(content)
        values = {tag: struct.unpack_from("=" + kind, content, at)[0] for tag, (kind, at) in fields.items()}
    except struct.error:
        return None
    needed = {_WIDTH, _LENGTH, _OFFSETS, _ROWS_PER_STRIP, _BYTE_COUNTS}
    if not needed <= values.keys() or any(values.get(tag) != value for tag, value in _MOSAIC.items()):
        return None
    block = SampleBlock(values[_OFFSETS], (values[_LENGTH], values[_WIDTH]), fields)
    whole = values[_ROWS_PER_STRIP] >= block.shape[0] and values[_BYTE_COUNTS] == block.end - block.start
    return block if whole and block.start % 2 == 0 and block.end >= len(content) else None


def first_rows(content: mmap.mmap | bytes, block: SampleBlock, rows: int) -> bytes:
    """The same file with its first rows alone; the others are not touched."""
    size = 2 * block.shape[1] * rows
    head = bytearray(content[: block.start + size])
    for tag, value in ((_LENGTH, rows), (_ROWS_PER_STRIP, rows), (_BYTE_COUNTS, size)):
        kind, at = block.fields[tag]
        struct.pack_into("=" + kind, head, at, value)
    return bytes(head)


def _fields(content: mmap.mmap | bytes) -> dict[int, tuple[str, int]]:
    """Type letter and place of the value of every tag of the first directory that is one whole number."""
    (directory,) = struct.unpack_from("=I", content, 4)
    (entries,) = struct.unpack_from("=H", content, directory)
    found = {}
    for at in range(directory + 2, directory + 2 + 12 * entries, 12):
        tag, kind, count = struct.unpack_from("=HHI", content, at)
        if kind in _TYPES and count == 1:
            found[tag] = (_TYPES[kind], at + 8)
    return found
