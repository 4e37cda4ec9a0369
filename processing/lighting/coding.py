"""Ways to write cuts: by index or by height for comparison, in pre-order for the disk.

Nodes stand from left to right and cuts one after another; since every path from the root to a leaf has exactly one node
of its cut, heights tell where a cut ends. Source of the first two: Iwasaki et al., V.A.2.
"""

import zlib
from itertools import pairwise

import numba
import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.lighting.cuts import Cuts, trailing_zeros
from processing.lighting.toggles import run_height
from processing.products.arrays import Float32

UInt8 = NDArray[np.uint8]
UInt16 = NDArray[np.uint16]
Int64 = NDArray[np.int64]

HEIGHT_BITS = 4  # 0 to 15
INDEX_BITS = 16  # the root is 1, the children of node i are 2 i and 2 i + 1
VALUE_STEPS = 65535  # values of SVC nodes lie in 0 to 1


def height_form(cuts: Cuts) -> bytes:
    """Binary cuts in 5 bits a node: height and value."""
    return _pack(2 * cuts.heights.astype(np.uint32) + _bits(cuts), HEIGHT_BITS + 1)


def from_height_form(code: bytes, nodes: int, height: int) -> Cuts:
    """What `height_form` wrote, of as many nodes over 2^height leaves."""
    fields = _unpack(code, HEIGHT_BITS + 1, nodes)
    return _cuts((fields >> 1).astype(np.uint8), (fields & 1).astype(np.float32), height)


def index_form(cuts: Cuts, height: int) -> bytes:
    """Binary cuts in 17 bits a node: the node's number and value, as in earlier work."""
    return _pack(2 * node_numbers(cuts.heights, height) + _bits(cuts), INDEX_BITS + 1)


def from_index_form(code: bytes, nodes: int, height: int) -> Cuts:
    """What `index_form` wrote, of as many nodes over 2^height leaves."""
    fields = _unpack(code, INDEX_BITS + 1, nodes)
    depth = np.frexp((fields >> 1).astype(np.float64))[1] - 1
    return _cuts((height - depth).astype(np.uint8), (fields & 1).astype(np.float32), height)


def node_numbers(heights: UInt8, height: int) -> NDArray[np.uint32]:
    """Number (n,) of each node in its tree of 2^height leaves: 1 is the root, 2 i and 2 i + 1 the children of i."""
    wide = heights.astype(np.int64)
    begin = np.concatenate([[0], np.cumsum(1 << wide)[:-1]]) % (1 << height)
    return ((1 << (height - wide)) + (begin >> wide)).astype(np.uint32)


def value_codes(values: Float32) -> UInt16:
    """Values of 0 to 1 in two bytes, which are at most 1 / 131 070 off."""
    return np.rint(np.clip(values, 0, 1) * VALUE_STEPS).astype(np.uint16)


def valued_height_form(cuts: Cuts) -> bytes:
    """Cuts with values of 0 to 1 in 20 bits a node: height and value."""
    return _pack(cuts.heights.astype(np.uint32), HEIGHT_BITS) + value_codes(cuts.values).astype("<u2").tobytes()


def from_valued_height_form(code: bytes, nodes: int, height: int) -> Cuts:
    """What `valued_height_form` wrote, of as many nodes over 2^height leaves."""
    split = (nodes * HEIGHT_BITS + 7) // 8
    values = np.frombuffer(code, "<u2", offset=split)
    return _cuts(_unpack(code[:split], HEIGHT_BITS, nodes).astype(np.uint8), _values(values), height)


def toggles_to_disk(first: Int64, toggles: UInt16, height: int) -> bytes:
    """Binary functions as their lossless cuts in pre-order, compressed.

    A node is 1 where it has children and 0 where it is of the cut; then follows its value. What is known is left out:
    that leaves have no children, and the value of a right sibling of one of the cut, which is the other.
    """
    return zlib.compress(np.packbits(_preorder(first, toggles, height)).tobytes(), 9)


def toggles_from_disk(code: bytes, functions: int, height: int) -> tuple[Int64, UInt16]:
    """Bounds (functions + 1,) and changes of what `toggles_to_disk` wrote. Raises ImageError where it is damaged."""
    try:
        bits = np.unpackbits(np.frombuffer(zlib.decompress(code), np.uint8))
    except zlib.error as error:
        raise ImageError(f"visibility cuts: damaged ({error}); compute them again") from error
    first, toggles = _from_preorder(bits, functions, height)
    if len(first) != functions + 1:
        raise ImageError(f"visibility cuts: they end after {len(first) - 1} of {functions}; compute them again")
    return first, toggles


def cuts_to_disk(cuts: Cuts, height: int) -> bytes:
    """Cuts with values of 0 to 1: pre-order bits and two bytes of value for each node that is not 0, compressed."""
    codes = value_codes(cuts.values)
    shape, some = np.packbits(_shape(cuts.heights, height)).tobytes(), codes[codes > 0]
    planes = (np.packbits(codes > 0), (some >> 8).astype(np.uint8), (some & 255).astype(np.uint8))
    parts = [zlib.compress(part, 9) for part in (shape, *(plane.tobytes() for plane in planes))]
    sizes = np.array([len(cuts), len(cuts.heights), *map(len, parts)], "<i8")
    return sizes.tobytes() + b"".join(parts)


def cuts_from_disk(code: bytes, height: int) -> Cuts:
    """What `cuts_to_disk` wrote; values are rounded as told there. Raises ImageError where it is damaged."""
    try:
        _, nodes, *lengths = np.frombuffer(code, "<i8", 6).tolist()
        ends = 48 + np.concatenate([[0], np.cumsum(lengths)])
        shape, some, high, low = (
            np.frombuffer(zlib.decompress(code[start:end]), np.uint8) for start, end in pairwise(ends)
        )
        heights = _heights(np.unpackbits(shape), nodes, height)
        values = np.zeros(nodes, np.uint16)
        values[np.unpackbits(some, count=nodes).astype(bool)] = (high.astype(np.uint16) << 8) | low
    except (zlib.error, ValueError, IndexError) as error:
        raise ImageError(f"self-visibility cuts: damaged ({error}); compute them again") from error
    return _cuts(heights, _values(values), height)


def _bits(cuts: Cuts) -> NDArray[np.uint32]:
    return (cuts.values > 0.5).astype(np.uint32)


def _values(codes: UInt16) -> Float32:
    return codes.astype(np.float32) / np.float32(VALUE_STEPS)


def _cuts(heights: UInt8, values: Float32, height: int) -> Cuts:
    after = np.cumsum(1 << heights.astype(np.int64))
    ends = np.flatnonzero(after % (1 << height) == 0) + 1
    return Cuts(np.concatenate([[0], ends]), heights, values)


def _pack(fields: NDArray[np.uint32], width: int) -> bytes:
    """Fields of some bits each, without gaps."""
    code = np.zeros((len(fields) * width + 7) // 8 + 4, np.uint8)
    _write_fields(fields, width, code)
    return code[:-4].tobytes()


def _unpack(code: bytes, width: int, count: int) -> NDArray[np.uint32]:
    fields = np.empty(count, np.uint32)
    if len(code) != (count * width + 7) // 8:
        raise ImageError(f"cuts: {len(code)} bytes are not {count} nodes of {width} bits; compute them again")
    _read_fields(np.frombuffer(code + bytes(4), np.uint8), width, fields)
    return fields


@numba.njit(cache=True, nogil=True)
def _write_fields(fields: NDArray[np.uint32], width: int, code: UInt8) -> None:
    for i in range(len(fields)):
        bit = i * width
        rest = np.uint64(fields[i]) << np.uint64(bit & 7)
        for k in range(4):
            code[(bit >> 3) + k] |= np.uint8((rest >> np.uint64(8 * k)) & np.uint64(255))


@numba.njit(cache=True, nogil=True)
def _read_fields(code: UInt8, width: int, fields: NDArray[np.uint32]) -> None:
    for i in range(len(fields)):
        bit, whole = i * width, np.uint64(0)
        for k in range(4):
            whole |= np.uint64(code[(bit >> 3) + k]) << np.uint64(8 * k)
        fields[i] = np.uint32((whole >> np.uint64(bit & 7)) & np.uint64((1 << width) - 1))


@numba.njit(cache=True, nogil=True)
def _preorder(first: Int64, toggles: UInt16, height: int) -> UInt8:
    bits, n = np.empty(64 + 4 * len(toggles), np.uint8), 0
    for i in range(len(first) - 1):
        position, k, visible, last = 0, first[i], 1, -1
        while position < 1 << height:
            end = toggles[k] if k < first[i + 1] else 1 << height
            k += 1
            while position < end:
                if len(bits) < n + 2 * height + 2:
                    grown = np.empty(2 * len(bits) + 2 * height, np.uint8)
                    grown[:n] = bits[:n]
                    bits = grown
                node = run_height(position, end, height)
                n = _write_node(bits, n, position, node, height)
                if not _is_other(position, node, last):
                    bits[n] = visible
                    n += 1
                last = node
                position += 1 << node
            visible = 1 - visible
    return bits[:n]


@numba.njit(cache=True, nogil=True)
def _is_other(position: int, node: int, last: int) -> bool:
    """Whether the node's sibling was the node before it, so that its value is the other one."""
    return last == node and (position >> node) & 1 == 1


@numba.njit(cache=True, nogil=True)
def _write_node(bits: UInt8, n: int, position: int, node: int, height: int) -> int:
    """A 1 for every node that begins here and has children, a 0 for the one that has none, unless it is a leaf."""
    top = height if position == 0 else trailing_zeros(position)
    for _ in range(top - node):
        bits[n] = 1
        n += 1
    if node > 0:
        bits[n] = 0
        n += 1
    return n


@numba.njit(cache=True, nogil=True)
def _read_node(bits: UInt8, n: int, position: int, height: int) -> tuple[int, int]:
    """Height of the node that begins here and the bit after it; -1 where the bits end."""
    node = height if position == 0 else trailing_zeros(position)
    while node > 0:
        if n >= len(bits):
            return -1, n
        n += 1
        if bits[n - 1] == 0:
            break
        node -= 1
    return node, n


@numba.njit(cache=True, nogil=True)
def _from_preorder(bits: UInt8, functions: int, height: int) -> tuple[Int64, UInt16]:
    first, toggles, k, n = np.zeros(functions + 1, np.int64), np.empty(len(bits) + functions + 1, np.uint16), 0, 0
    for i in range(functions):
        position, visible, last = 0, 1, -1
        while position < 1 << height:
            node, n = _read_node(bits, n, position, height)
            other = _is_other(position, node, last)
            if node < 0 or (n >= len(bits) and not other):
                return first[: i + 1], toggles[:k].copy()
            value = 1 - visible if other else bits[n]
            n += 0 if other else 1
            if value != visible:
                toggles[k], visible = position, value
                k += 1
            last = node
            position += 1 << node
        first[i + 1] = k
    return first, toggles[:k].copy()


@numba.njit(cache=True, nogil=True)
def _shape(heights: UInt8, height: int) -> UInt8:
    bits, n, position = np.empty(2 * len(heights) + height, np.uint8), 0, 0
    for node in heights:
        n = _write_node(bits, n, position, node, height)
        position = (position + (1 << node)) & ((1 << height) - 1)
    return bits[:n].copy()


@numba.njit(cache=True, nogil=True)
def _heights(bits: UInt8, nodes: int, height: int) -> UInt8:
    heights, n, position = np.zeros(nodes, np.uint8), 0, 0
    for i in range(nodes):
        node, n = _read_node(bits, n, position, height)
        if node < 0:
            return heights[:i]
        heights[i] = node
        position = (position + (1 << node)) & ((1 << height) - 1)
    return heights
