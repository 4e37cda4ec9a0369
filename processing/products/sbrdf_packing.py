"""One RGBA8 texture for shadows, shifts, hidden points and their clusters (Chen et al. 2008, section 3.1 and fig. 12).

Map i, a tile of the texture, holds the shadow under light i in R, and of view i the shift right and down in G and B, or
the high and low byte of the index of a centre where A tells that the point is hidden. Maps lie left to right, top to
bottom; under them each centre is a column of RGB, one texel for each light.
"""

from dataclasses import dataclass
from functools import cached_property
from math import frexp, isqrt, ldexp

import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.products.arrays import Float32, Float64

UInt8 = NDArray[np.uint8]
Index = NDArray[np.intp]

_CODES = 256
_MOST_CENTRES = 1 << 16  # their index has 16 bits
_HIDDEN = 255


@dataclass(frozen=True)
class TextureLayout:
    """Where maps of `height` x `width` texels and centres lie, for so many lights and views.

    As many maps stand in a row as the power of two at or above the root of their number, and the texture's sides are
    powers of two: 1024 x 512 for 81 maps of 64 x 64. Columns of centres fill what is left under the full rows of maps,
    blocks of one texel per light under each other, except columns that the last, partial row of maps reaches into. The
    texture is doubled in height until there is a centre for every view, which small tiles need.
    """

    lights: int
    views: int
    height: int
    width: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the texture."""
        rows = _power_of_two(-(-self._maps // self._per_row) * self.height)
        while self._capacity(rows) < self.views:
            rows *= 2
        return rows, self._columns

    @property
    def centres(self) -> int:
        """Columns for centres: 1984 for 81 lights and views of 64 x 64 texels."""
        return min(self._capacity(self.shape[0]), _MOST_CENTRES)

    @property
    def shift_steps(self) -> tuple[int, int]:
        """Steps of the shift along a whole tile, right and down: whole texels are whole steps up to 256 texels."""
        return _steps(self.width), _steps(self.height)

    @cached_property
    def map_rows(self) -> Index:
        """Rows of the texture (map, y, 1)."""
        corner = np.arange(self._maps) // self._per_row * self.height
        return corner[:, None, None] + np.arange(self.height)[:, None]

    @cached_property
    def map_columns(self) -> Index:
        """Columns of the texture (map, 1, x)."""
        corner = np.arange(self._maps) % self._per_row * self.width
        return corner[:, None, None] + np.arange(self.width)

    @cached_property
    def centre_corners(self) -> Index:
        """Row of the first light and column of each centre (centre, 2)."""
        blocks = (self.shape[0] - self._full_rows) // self.lights
        first = [self._first_column(block) for block in range(blocks)]
        columns = [np.arange(start, self._columns) for start in first]
        rows = [np.full(len(some), self._full_rows + i * self.lights) for i, some in enumerate(columns)]
        return np.stack([np.concatenate(rows), np.concatenate(columns)], axis=1)[: self.centres]

    @property
    def _maps(self) -> int:
        return max(self.lights, self.views)

    @property
    def _per_row(self) -> int:
        return _power_of_two(isqrt(self._maps - 1) + 1)

    @property
    def _columns(self) -> int:
        return _power_of_two(self._per_row * self.width)

    @property
    def _full_rows(self) -> int:
        """Rows of the texture above the partial row of maps."""
        return self._maps // self._per_row * self.height

    def _first_column(self, block: int) -> int:
        reached = block * self.lights < self.height
        return self._maps % self._per_row * self.width if reached else 0

    def _capacity(self, rows: int) -> int:
        blocks = (rows - self._full_rows) // self.lights
        return sum(self._columns - self._first_column(block) for block in range(blocks))


@dataclass(frozen=True, eq=False)
class SbrdfMaps:
    """What the texture holds: `shadow` (light, y, x) in 0 to 1, `shift` (view, y, x, 2) in texels, `hidden`, `cluster`
    (view, y, x), and `centres` (k, light, 3), which are values with the cosine to the light inside.
    """

    shadow: Float32
    shift: Float32
    hidden: NDArray[np.bool_]
    cluster: NDArray[np.uint16]
    centres: Float32

    @property
    def layout(self) -> TextureLayout:
        """That of their lights, views and texels."""
        return TextureLayout(len(self.shadow), *self.hidden.shape)


@dataclass(frozen=True, eq=False)
class PackedMaps:
    """`texture` (row, column, RGBA) with `centres` columns in use; a code of 255 of a centre stands for `scale`."""

    texture: UInt8
    layout: TextureLayout
    centres: int
    scale: float


def pack(maps: SbrdfMaps) -> PackedMaps:
    """The texture. Missing shadows count as lit, missing shifts and values as 0.

    Shifts wrap, as the texture does: what is unpacked lies within half a tile. Centres are coded by their cube
    roots: highlights are a hundred times as bright as the rest, which square roots leave too few codes for.
    Raises ImageError for more centres than there is room for, and for a hidden point whose centre there is not.
    """
    layout, scale = maps.layout, _scale(maps.centres)
    _check_centres(maps)
    texture = np.zeros((*layout.shape, 4), np.uint8)
    texture[(*_map_places(layout, layout.lights), 0)] = _bytes(np.nan_to_num(maps.shadow, nan=1.0))
    texture[(*_map_places(layout, layout.views), slice(1, 4))] = _view_codes(maps)
    root = np.cbrt(np.clip(np.nan_to_num(maps.centres) / scale, 0, 1))
    texture[(*_centre_places(layout, len(root)), slice(0, 3))] = _bytes(root)
    return PackedMaps(texture, layout, len(root), scale)


def unpack(packed: PackedMaps) -> SbrdfMaps:
    """What the texture holds. Packed again it gives the same bytes.

    Raises ImageError for a texture of another shape than the layout's, and for a hidden point without its centre.
    """
    layout, texture = packed.layout, packed.texture
    if texture.shape != (*layout.shape, 4):
        raise ImageError(f"the texture is {texture.shape}, where {(*layout.shape, 4)} belongs to the product")
    shadow = texture[(*_map_places(layout, layout.lights), 0)] / np.float32(255)
    codes = texture[(*_map_places(layout, layout.views), slice(1, 4))]
    hidden = codes[..., 2] == _HIDDEN
    cluster = np.where(hidden, codes[..., 0] * np.uint16(_CODES) + codes[..., 1], 0).astype(np.uint16)
    shift = np.where(hidden[..., None], 0, _shift(codes[..., :2], layout)).astype(np.float32)
    root = texture[(*_centre_places(layout, packed.centres), slice(0, 3))] / 255.0
    maps = SbrdfMaps(shadow, shift, hidden, cluster, (root**3 * packed.scale).astype(np.float32))
    _check_centres(maps)
    return maps


def _check_centres(maps: SbrdfMaps) -> None:
    count, room = len(maps.centres), maps.layout.centres
    if count > room:
        raise ImageError(f"{count} centres of hidden points, where the texture has room for {room}")
    if (maps.cluster[maps.hidden] >= count).any():
        raise ImageError(f"a hidden point names a centre beyond the {count} that there are")


def _map_places(layout: TextureLayout, count: int) -> tuple[Index, Index]:
    return layout.map_rows[:count], layout.map_columns[:count]


def _centre_places(layout: TextureLayout, count: int) -> tuple[Index, Index]:
    """Rows (centre, light) and columns (centre, 1)."""
    corners = layout.centre_corners[:count]
    return corners[:, :1] + np.arange(layout.lights), corners[:, 1:]


def _view_codes(maps: SbrdfMaps) -> UInt8:
    """G, B and A (view, y, x, 3) of the maps of views."""
    cells = np.array(maps.hidden.shape[:0:-1])
    steps = np.array(maps.layout.shift_steps)
    shift = np.rint(np.nan_to_num(maps.shift).astype(np.float64) * (steps / cells)).astype(np.int64) % steps
    centre = np.stack([maps.cluster // _CODES, maps.cluster % _CODES], axis=-1)
    codes = np.where(maps.hidden[..., None], centre, shift)
    return np.concatenate([codes, maps.hidden[..., None] * _HIDDEN], axis=-1).astype(np.uint8)


def _shift(codes: UInt8, layout: TextureLayout) -> Float64:
    """Texels, from half a tile left or up to less than half a tile right or down."""
    steps = np.array(layout.shift_steps)
    signed = codes.astype(np.int64)
    signed -= np.where(2 * signed >= steps, steps, 0)
    texels: Float64 = signed * (np.array([layout.width, layout.height]) / steps)
    return texels


def _scale(centres: Float32) -> float:
    """The largest value to eleven bits, so that what was unpacked has the same scale again."""
    largest = float(np.nan_to_num(centres).max(initial=0.0))
    mantissa, exponent = frexp(largest)
    return ldexp(round(mantissa * 2048) / 2048, exponent) if largest > 0 else 1.0


def _bytes(share: Float32) -> UInt8:
    codes: UInt8 = np.rint(255.0 * np.clip(share, 0, 1)).astype(np.uint8)
    return codes


def _steps(texels: int) -> int:
    return max(_CODES // texels, 1) * texels if texels <= _CODES else _CODES


def _power_of_two(least: int) -> int:
    return 1 << (least - 1).bit_length()
