"""The factored bidirectional texture function on the graphics card; its shader is shaders/btf.glsl."""

import moderngl
import numpy as np

from processing.products import FactoredBtf
from render.arrays import Float64, Rows
from render.errors import MaterialError
from render.programs import Binding
from render.textures import direction_tables, table, texture_array

SHADER = "btf.frag"


def upload(context: moderngl.Context, btf: FactoredBtf) -> Binding:
    """Array textures of eigenmaps, four terms to a texel, and tables: weights, coding, two meshes of directions.

    Codes stay codes on the card. Raises MaterialError for another number of channels than 3, and where there is no
    room.
    """
    if btf.channels != 3:
        raise MaterialError(f"BTF of {btf.channels} channels: the preview draws 3")
    rank, lights = btf.eigenmaps.shape[:2]
    maps = _by_fours(btf.eigenmaps)
    fours, what = len(maps), f"BTF of {rank} x {lights} maps"
    ambient = _by_fours(btf.ambient_maps[:, None].astype(np.float32))
    textures: dict[str, moderngl.Texture | moderngl.TextureArray] = {
        "eigenmaps": texture_array(context, maps.reshape(-1, *maps.shape[3:]), what),
        "ambient_maps": texture_array(context, ambient.reshape(-1, *maps.shape[3:]), what),
        "view_weights": table(context, _weights(btf.colours)),
    }
    defines = {f"FOURS {fours}"} | ({"GREY"} if btf.eigenmaps.shape[4] == 1 else set())
    if btf.coding is not None:
        # A byte is read as its 255th.
        unit = 255.0 if btf.eigenmaps.dtype == np.uint8 else 1.0
        pairs = np.stack([_in_fours(btf.coding.least), _in_fours(unit * btf.coding.step)], axis=1)
        textures["map_coding"] = table(context, pairs.reshape(2 * fours, lights, 4).swapaxes(0, 1))
        defines |= {"CODED"}
    for name, mesh in (("light", btf.lights), ("view", btf.views)):
        textures |= direction_tables(context, name, mesh)
    return Binding(SHADER, textures, {"lights": lights}, frozenset(defines))


def outgoing(btf: FactoredBtf, uv: Rows, light: Rows, view: Rows) -> Float64:
    """Radiance (n, 3) for unit irradiance on a surface that faces the light: reflectance times cosine, in NumPy."""
    return btf.evaluate(uv, light, view) * np.maximum(light[:, 2:3], 0.0)


def _in_fours(terms: Rows) -> Rows:
    """An array (k, ...) as (four, ..., 4), with 0 for terms that are not."""
    padded = np.zeros((-(-len(terms) // 4) * 4, *terms.shape[1:]), terms.dtype)
    padded[: len(terms)] = terms
    return np.moveaxis(padded.reshape(-1, 4, *terms.shape[1:]), 1, -1)


def _by_fours(maps: Rows) -> Rows:
    """Maps (k, light, y, x, channel) as (four, channel, light, y, x, 4)."""
    return np.ascontiguousarray(np.moveaxis(_in_fours(maps), 4, 1))


def _weights(colours: Rows) -> Rows:
    """Weights (k, view, colour) as rows (four, colour) and columns of views, (row, view, 4)."""
    fours = np.moveaxis(_in_fours(colours), 2, 1)
    return fours.reshape(-1, *fours.shape[2:])
