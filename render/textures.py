"""Textures whose nearest texel is read: the shaders filter by hand, since hardware filters with 8-bit weights."""

from typing import Any, TypeVar

import moderngl
import numpy as np

from processing.products import DirectionMesh
from render.arrays import Rows
from render.errors import MaterialError

_MOST_REGIONS = 1 << 10
# As moderngl calls them.
_NAMES = {np.dtype(kind): name for kind, name in (("f4", "f4"), ("f2", "f2"), ("u4", "u4"), ("u1", "f1"))}
Sampled = TypeVar("Sampled", moderngl.Texture, moderngl.TextureArray)


def texture_array(context: moderngl.Context, layers: Rows, what: str, *, wrap: bool = True) -> moderngl.TextureArray:
    """Layers (layer, y, x, 1 to 4), which repeat or end, as float32; as uint32, float16 or bytes if they are.

    A byte is read as its 255th. Raises MaterialError where there is no room.
    """
    count, height, width, channels = layers.shape
    for limit, value, unit in (
        ("GL_MAX_ARRAY_TEXTURE_LAYERS", count, "layers"),
        ("GL_MAX_TEXTURE_SIZE", max(height, width), "texels a side"),
    ):
        if value > context.info[limit]:
            raise MaterialError(f"{what}: {value} {unit}, the graphics library takes {context.info[limit]}")
    # Four components lie on whole words: a fetch of three was measured to cost a quarter more.
    components = 4 if channels == 3 else channels
    data = np.zeros((count, height, width, components), dtype=_dtype(layers))
    data[..., :channels] = layers
    size = (width, height, count)
    texture = context.texture_array(size, components, data.tobytes(), dtype=_name(data), alignment=1)
    return _nearest(texture, wrap=wrap)


def table(context: moderngl.Context, values: Rows) -> moderngl.Texture:
    """A table (row, column, component) as a float32 texture, or uint32 if it is one.

    Whole numbers up to 2^24 stay exact. Like textures it is read at the middle of a texel, which costs less than by
    texelFetch.
    """
    height, width, components = values.shape
    limit = context.info["GL_MAX_TEXTURE_SIZE"]
    if max(height, width) > limit:
        raise MaterialError(f"a table of {height} x {width} numbers: the graphics library takes {limit} a side")
    data = np.ascontiguousarray(values, dtype=_dtype(values))
    size = (width, height)
    return _nearest(context.texture(size, components, data.tobytes(), dtype=_name(data), alignment=1), wrap=False)


def direction_tables(context: moderngl.Context, name: str, mesh: DirectionMesh) -> dict[str, moderngl.Texture]:
    """Cells of region numbers, and regions, a row of two texels each, as directions.glsl reads them.

    Raises MaterialError for more directions or regions than their ten bits tell.
    """
    regions = mesh.regions
    if max(len(regions.corners), len(mesh.directions)) > _MOST_REGIONS:
        raise MaterialError(f"{len(mesh.directions)} directions: the preview takes at most some {_MOST_REGIONS // 2}")
    numbers = np.hstack([regions.origin, regions.slopes.reshape(-1, 4)]).astype(np.float32).view(np.uint32)
    counted = regions.counted.astype(np.uint32)
    names = np.stack([_three(regions.beyond, counted[:, 0]), _three(regions.corners, counted[:, 1])], axis=1)
    return {
        f"{name}_cells": table(context, mesh.cells[:, :, None]),
        f"{name}_regions": table(context, np.hstack([numbers, names]).reshape(-1, 2, 4)),
    }


def _three(numbers: Rows, flag: Rows) -> Rows:
    """Three numbers (n, 3) of ten bits in one word (n,), and a flag above them."""
    a, b, c = numbers.astype(np.uint32).T
    return np.asarray(a | b << np.uint32(10) | c << np.uint32(20) | flag << np.uint32(30))


def _nearest(texture: Sampled, *, wrap: bool) -> Sampled:
    """The texture, whose nearest texel is read; it repeats or ends."""
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
    texture.repeat_x = texture.repeat_y = wrap
    return texture


def _dtype(values: Rows) -> np.dtype[Any]:
    return values.dtype if values.dtype in _NAMES else np.dtype(np.float32)


def _name(values: Rows) -> str:
    return _NAMES[values.dtype]
