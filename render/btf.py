"""The factored bidirectional texture function on the graphics card; its shader is shaders/btf.glsl."""

import moderngl
import numpy as np

from processing.products import FactoredBtf
from render.arrays import Float64, Rows
from render.programs import Binding
from render.textures import direction_tables, table, texture_array

SHADER = "btf.frag"


def upload(context: moderngl.Context, btf: FactoredBtf) -> Binding:
    """One array texture, whose layers are (k, light) and then k in ambient light, weights (k, view), two meshes."""
    rank, lights, height, width, channels = btf.eigenmaps.shape
    maps = btf.eigenmaps.reshape(rank * lights, height, width, channels)
    layers = np.concatenate([maps, btf.ambient_maps.astype(np.float32)])
    textures: dict[str, moderngl.Texture | moderngl.TextureArray] = {
        "eigenmaps": texture_array(context, layers, f"BTF of {rank} x {lights} maps"),
        "view_weights": table(context, btf.weights[:, :, None]),
    }
    values = {"rank": rank, "lights": lights}
    for name, mesh in (("light", btf.lights), ("view", btf.views)):
        textures |= direction_tables(context, name, mesh)
    return Binding(SHADER, textures, values)


def outgoing(btf: FactoredBtf, uv: Rows, light: Rows, view: Rows) -> Float64:
    """Radiance (n, 3) for unit irradiance on a surface that faces the light: reflectance times cosine, in NumPy."""
    return btf.evaluate(uv, light, view) * np.maximum(light[:, 2:3], 0.0)
