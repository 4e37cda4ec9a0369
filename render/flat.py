"""A flat textured surface: one colour per texel and a cosine, the yardstick for frame times."""

from dataclasses import dataclass

import moderngl
import numpy as np

from processing.products import bilinear_taps
from render.arrays import Float32, Float64, Rows
from render.programs import Binding
from render.textures import texture_array

SHADER = "flat.frag"


@dataclass(frozen=True, eq=False)
class FlatTexture:
    """A Lambertian texture that repeats: `albedo` (y, x, 3) float32 from 0 to 1."""

    albedo: Float32


def upload(context: moderngl.Context, flat: FlatTexture) -> Binding:
    """One layer of colour."""
    return Binding(SHADER, {"albedo": texture_array(context, flat.albedo[None], "texture")})


def outgoing(flat: FlatTexture, uv: Rows, light: Rows, view: Rows) -> Float64:
    """Radiance (n, 3) for unit irradiance on a surface that faces the light: albedo times cosine over pi."""
    del view
    rows, columns, weights = bilinear_taps(uv, *flat.albedo.shape[:2], wrap=True)
    albedo = np.einsum("nt,ntc->nc", weights, flat.albedo[rows, columns].astype(np.float64))
    return np.asarray(albedo * np.maximum(light[:, 2:3], 0.0) / np.pi)
