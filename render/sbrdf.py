"""SBRDF+ on the graphics card: lobes, shadows, shifts and clusters; its shader is shaders/sbrdf.frag."""

import moderngl
import numpy as np

from processing.products import LafortuneTexels, SbrdfPlus
from render.arrays import Float32, Float64, Rows
from render.programs import Binding
from render.textures import direction_tables, table, texture_array

SHADER = "sbrdf.frag"
# Added to the row of a hidden point's centre, where others have their shift to the right; as in the shader.
_HIDDEN = 2.0**20


def upload(context: moderngl.Context, sbrdf: SbrdfPlus) -> Binding:
    """Shifts and shadows of four neighbours in one texel, lobes a texel each, and the centres."""
    lobes = _lobe_layers(sbrdf.lobes)
    textures: dict[str, moderngl.Texture | moderngl.TextureArray] = {
        "shift": texture_array(context, _neighbours(_shift_layers(sbrdf)), "shifts of the SBRDF+"),
        "shadow": texture_array(context, _neighbours(sbrdf.shadow), "shadows of the SBRDF+"),
        "lobes": texture_array(context, lobes, "lobes of the SBRDF+"),
        "centres": table(context, sbrdf.centres if len(sbrdf.centres) else np.zeros((1, 1, 3))),
    }
    for name, mesh in (("light", sbrdf.lights), ("view", sbrdf.views)):
        textures |= direction_tables(context, name, mesh)
    return Binding(SHADER, textures, defines=frozenset([f"LOBES {_present(sbrdf.lobes)}"]))


def outgoing(sbrdf: SbrdfPlus, uv: Rows, light: Rows, view: Rows) -> Float64:
    """Radiance (n, 3) for unit irradiance on a surface that faces the light, in NumPy."""
    return sbrdf.evaluate(uv, light, view)


def _shift_layers(sbrdf: SbrdfPlus) -> Float64:
    """Layers (2 view, y, x): shift to the right, or where the centre of a hidden point is, and shift downward."""
    right = np.where(sbrdf.hidden, _HIDDEN + sbrdf.cluster, sbrdf.shift[..., 0])
    return np.stack([right, sbrdf.shift[..., 1]], axis=1).reshape(-1, *sbrdf.lobes.shape)


def _neighbours(layers: Rows) -> Float32:
    """Layers (n, y, x) with each texel's right, lower and right lower neighbour beside it, (n, y, x, 4)."""
    right = np.roll(layers, -1, axis=2)
    around = (layers, right, np.roll(layers, -1, axis=1), np.roll(right, -1, axis=1))
    return np.stack(around, axis=3).astype(np.float32)


def _lobe_layers(lobes: LafortuneTexels) -> Float32:
    """Layers (n, y, x, 4): axis and exponent of each lobe, then the colours of all, the diffuse one last."""
    present = _present(lobes)
    order = np.argsort(~_is_there(lobes), axis=2, kind="stable")[:, :, :present, None]
    exponent = np.take_along_axis(lobes.exponent[..., None], order, axis=2)
    shapes = np.concatenate([np.take_along_axis(lobes.axis, order, axis=2), exponent], axis=3)
    colours = np.concatenate([np.take_along_axis(lobes.albedo, order, axis=2), lobes.diffuse[:, :, None]], axis=2)
    numbers = colours.reshape(*lobes.shape, -1)
    padded = np.concatenate([numbers, np.zeros((*lobes.shape, -numbers.shape[2] % 4), np.float32)], axis=2)
    return np.concatenate([np.moveaxis(shapes, 2, 0), np.moveaxis(padded.reshape(*lobes.shape, -1, 4), 2, 0)])


def _present(lobes: LafortuneTexels) -> int:
    """The most lobes that any texel has."""
    return int(_is_there(lobes).sum(axis=2).max(initial=0))


def _is_there(lobes: LafortuneTexels) -> Rows:
    """Which lobes reflect anything, (y, x, lobe)."""
    return np.asarray((lobes.albedo != 0.0).any(axis=3))
