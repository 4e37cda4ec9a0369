"""Which materials can be drawn: for each its module, with `upload` for the card and `outgoing` in NumPy.

A further material is one module, one shader and one line here.
"""

from types import ModuleType
from typing import TypeGuard

import moderngl

from processing.products import FactoredBtf, Mesostructure, SbrdfPlus, Srf
from render import btf, flat, mesostructure, sbrdf, srf
from render.arrays import Float64, Rows
from render.errors import MaterialError
from render.flat import FlatTexture
from render.programs import Binding

Material = Srf | FactoredBtf | Mesostructure | SbrdfPlus | FlatTexture

_MODULES: dict[type, ModuleType] = {
    Srf: srf,
    FactoredBtf: btf,
    Mesostructure: mesostructure,
    SbrdfPlus: sbrdf,
    FlatTexture: flat,
}


def upload(context: moderngl.Context, material: Material) -> Binding:
    """The material's textures and numbers on the card; raises MaterialError for what cannot be drawn."""
    binding: Binding = _module(material).upload(context, material)
    return binding


def outgoing(material: Material, uv: Rows, light: Rows, view: Rows, footprint: Rows | None = None) -> Float64:
    """Radiance (n, 3) for unit irradiance at normal incidence.

    `uv` (n, 2); `light` and `view` (n, 3) are unit vectors in the tangent frame. The cosine to the light is inside.
    `footprint` (n, 2, 2), how `uv` changes to the next pixel right and below, is for materials that have levels; left
    out, a point of the finest one is asked.
    """
    if has_levels(material):
        return sbrdf.outgoing(material, uv, light, view, footprint)
    radiance: Float64 = _module(material).outgoing(material, uv, light, view)
    return radiance


def has_levels(material: Material) -> TypeGuard[SbrdfPlus]:
    """Whether the material is drawn differently where a pixel covers much of it."""
    return isinstance(material, SbrdfPlus) and bool(material.coarser)


def _module(material: Material) -> ModuleType:
    module = _MODULES.get(type(material))
    if module is None:
        known = ", ".join(sorted(kind.__name__ for kind in _MODULES))
        raise MaterialError(f"{type(material).__name__} is not a material that can be drawn; these are: {known}")
    return module
