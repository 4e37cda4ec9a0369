"""Float textures whose nearest texel is read: the shaders filter by hand, since hardware filters with 8-bit weights."""

import moderngl
import numpy as np

from processing.products import DirectionMesh
from render.arrays import Rows
from render.errors import MaterialError


def texture_array(context: moderngl.Context, layers: Rows, what: str, *, wrap: bool = True) -> moderngl.TextureArray:
    """Layers (layer, y, x, 3 or 4) as float32, which repeat or end; raises MaterialError where there is no room."""
    count, height, width, channels = layers.shape
    if channels not in (3, 4):
        raise MaterialError(f"{what}: {channels} channels, the preview draws 3")
    for limit, value, unit in (
        ("GL_MAX_ARRAY_TEXTURE_LAYERS", count, "layers"),
        ("GL_MAX_TEXTURE_SIZE", max(height, width), "texels a side"),
    ):
        if value > context.info[limit]:
            raise MaterialError(f"{what}: {value} {unit}, the graphics library takes {context.info[limit]}")
    # Four components lie on whole words: a fetch of three was measured to cost a quarter more.
    data = np.zeros((count, height, width, 4), dtype=np.float32)
    data[..., :channels] = layers
    texture = context.texture_array((width, height, count), 4, data.tobytes(), dtype="f4", alignment=1)
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
    texture.repeat_x = texture.repeat_y = wrap
    return texture


def table(context: moderngl.Context, values: Rows) -> moderngl.Texture:
    """A table (row, column, component) as a float32 texture; whole numbers up to 2^24 stay exact."""
    height, width, components = values.shape
    limit = context.info["GL_MAX_TEXTURE_SIZE"]
    if max(height, width) > limit:
        raise MaterialError(f"a table of {height} x {width} numbers: the graphics library takes {limit} a side")
    data = np.ascontiguousarray(values, dtype=np.float32)
    return context.texture((width, height), components, data.tobytes(), dtype="f4", alignment=1)


def direction_tables(context: moderngl.Context, name: str, mesh: DirectionMesh) -> dict[str, moderngl.Texture]:
    """Cells (64, 64) of region numbers; a region is a row of four texels, as directions.glsl reads them."""
    regions = mesh.regions
    count = len(regions.corners)
    zeros = np.zeros((count, 1))
    row = np.stack(
        [
            np.hstack([regions.origin, regions.counted]),
            regions.slopes.reshape(count, 4),
            np.hstack([regions.corners, zeros]),
            np.hstack([regions.beyond, zeros]),
        ],
        axis=1,
    )
    return {f"{name}_cells": table(context, mesh.cells[:, :, None]), f"{name}_regions": table(context, row)}
