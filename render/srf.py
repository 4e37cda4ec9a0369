"""The spatially varying residual function on the graphics card; its shader is shaders/srf.frag."""

from dataclasses import replace

import moderngl
import numpy as np

from processing.products import AnisotropicPhong, BlinnPhong, Lobe, Srf
from render.arrays import Float64, Rows
from render.programs import Binding
from render.textures import texture_array

SHADER = "srf.frag"


def upload(context: moderngl.Context, srf: Srf) -> Binding:
    """Each texel's coefficients function by function, colour by colour, four in a layer; undetermined ones are 0."""
    numbers = np.nan_to_num(srf.residual.transpose(3, 0, 1, 2)).reshape(-1, *srf.residual.shape[1:3])
    padded = np.concatenate([numbers, np.zeros((-len(numbers) % 4, *numbers.shape[1:]), np.float32)])
    layers = np.moveaxis(padded.reshape(-1, 4, *numbers.shape[1:]), 1, 3)
    return Binding(
        SHADER,
        {"residual": texture_array(context, layers, "SRF map", wrap=srf.wrap)},
        {
            "diffuse": tuple(map(float, srf.phong.diffuse)),
            "specular": tuple(map(float, srf.phong.specular)),
            "wrap": bool(srf.wrap),
            **_exponents(srf.phong),
        },
        frozenset([f"BASIS_{srf.basis.name}", *(["ANISOTROPIC"] if isinstance(srf.phong, AnisotropicPhong) else [])]),
    )


def _exponents(lobe: Lobe) -> dict[str, float | tuple[float, ...]]:
    """The exponent along and across an axis in the plane of t and b."""
    match lobe:
        case BlinnPhong():
            return {"exponents": (float(lobe.exponent),) * 2, "lobe_axis": (1.0, 0.0)}
        case AnisotropicPhong():
            along = (float(np.cos(lobe.turn_rad)), float(np.sin(lobe.turn_rad)))
            return {"exponents": (float(lobe.exponents[0]), float(lobe.exponents[1])), "lobe_axis": along}


def repeating(srf: Srf) -> Srf:
    """A map that ends, such as a sphere's, as a texture that repeats: mirrored at every border, so that values meet.

    Four times the texels. The residual vectors are mirrored in place but not turned round: a mirrored bump would want
    that, but it would tear the colour at every border, and lights on one circle measure colour better than bumps.
    """
    if srf.wrap:
        return srf
    row = np.concatenate([srf.residual, srf.residual[:, :, ::-1]], axis=2)
    return replace(srf, residual=np.concatenate([row, row[:, ::-1]], axis=1), wrap=True)


def outgoing(srf: Srf, uv: Rows, light: Rows, view: Rows) -> Float64:
    """Radiance (n, 3) for unit irradiance on a surface that faces the light, in NumPy."""
    return srf.evaluate(uv, light, view)
