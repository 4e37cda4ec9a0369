"""A BTF with the depths of its surface on the graphics card; its shader is shaders/mesostructure.frag."""

import moderngl
import numpy as np

from processing.products import Mesostructure
from render import btf
from render.arrays import Float64, Rows
from render.programs import Binding
from render.textures import direction_tables, texture_array

SHADER = "mesostructure.frag"


def upload(context: moderngl.Context, structure: Mesostructure) -> Binding:
    """The BTF's textures, an array texture of codes of depth, a layer for each view, and the mesh of these views."""
    shaded = btf.upload(context, structure.btf)
    # A texel holds its neighbours too: one look-up instead of four.
    right, below = np.roll(structure.depths, -1, axis=2), np.roll(structure.depths, -1, axis=1)
    codes = np.stack([structure.depths, right, below, np.roll(below, -1, axis=2)], axis=-1)
    textures = {
        **shaded.textures,
        "depths": texture_array(context, codes, f"depths of {len(codes)} views"),
        **direction_tables(context, "depth", structure.views),
    }
    values = {
        **shaded.values,
        "code_255": 255.0 * structure.step,
        "deepest": structure.deepest,
        "plane": structure.plane,
        "lowest_depth_view": structure.views.lowest,
    }
    return Binding(SHADER, textures, values, shaded.defines | {"WRAPPED"})


def outgoing(structure: Mesostructure, uv: Rows, light: Rows, view: Rows) -> Float64:
    """Radiance (n, 3) for unit irradiance on a surface that faces the light, in points of the texels' plane."""
    return btf.outgoing(structure.btf, uv, light, view)
