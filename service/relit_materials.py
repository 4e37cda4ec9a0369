"""Materials of bodies that are relit, as a person describes them: a model's numbers, a product's mean, a MERL file."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag

from processing.errors import ImageError
from processing.formats.merl import read_merl
from processing.lighting.brdfs import (
    Brdf,
    blinn_phong,
    ggx,
    lambert,
    mean_sbrdf_plus,
    mean_srf,
    tabulated,
    ward,
)
from processing.products import SbrdfPlus, Srf
from service.viewing import kind_of

_Share = Annotated[float, Field(ge=0, le=1)]
Colour = tuple[_Share, _Share, _Share]
_Roughness = Annotated[float, Field(ge=0.01, le=1)]

_MEANS: dict[str, Callable[[Path], Brdf]] = {
    "srf": lambda folder: mean_srf(Srf.load(folder)),
    "sbrdf_plus": lambda folder: mean_sbrdf_plus(SbrdfPlus.load(folder)),
}


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class LambertMaterial(_Model):
    """The same from everywhere (see `lambert`)."""

    kind: Literal["lambert"]
    albedo: Colour


class BlinnPhongMaterial(_Model):
    """A diffuse part, and a lobe of powers of the half angle's cosine (see `blinn_phong`)."""

    kind: Literal["blinn_phong"]
    diffuse: Colour
    specular: Colour
    exponent: float = Field(ge=0, le=1e5)


class WardMaterial(_Model):
    """A diffuse part, and a Gaussian lobe with a roughness along the level tangent and one across (see `ward`)."""

    kind: Literal["ward"]
    diffuse: Colour
    specular: Colour
    roughness: tuple[_Roughness, _Roughness]


class GgxMaterial(_Model):
    """Facets of one roughness that reflect so much at normal incidence, over a diffuse part (see `ggx`)."""

    kind: Literal["ggx"]
    diffuse: Colour
    normal_reflectance: Colour
    roughness: float = Field(ge=0.03, le=1)


class ProductMaterial(_Model):
    """The mean over the texels of the product in a folder: an SRF or an SBRDF+."""

    product: Path


class MerlMaterial(_Model):
    """What was measured, in a file of MERL's format."""

    merl: Path


def _form(table: object) -> str:
    """Which of the models a table is of: its `kind`, or the one file that it names."""
    fields: Mapping[str, object] = table if isinstance(table, Mapping) else getattr(table, "__dict__", {})
    return str(fields.get("kind") or next((name for name in ("product", "merl") if name in fields), ""))


Material = Annotated[
    Annotated[LambertMaterial, Tag("lambert")]
    | Annotated[BlinnPhongMaterial, Tag("blinn_phong")]
    | Annotated[WardMaterial, Tag("ward")]
    | Annotated[GgxMaterial, Tag("ggx")]
    | Annotated[ProductMaterial, Tag("product")]
    | Annotated[MerlMaterial, Tag("merl")],
    Discriminator(
        _form,
        custom_error_type="material",
        custom_error_message="a material has `kind` (lambert, blinn_phong, ward or ggx), `product` or `merl`",
    ),
]


def material_brdf(material: Material, folder: Path = Path()) -> Brdf:
    """The reflectance of a material; its paths are relative to `folder`.

    Raises ImageError where a product or file cannot be read, or is of another kind.
    """
    match material:
        case LambertMaterial():
            return lambert(np.array(material.albedo))
        case BlinnPhongMaterial():
            return blinn_phong(np.array(material.diffuse), np.array(material.specular), material.exponent)
        case WardMaterial():
            return ward(np.array(material.diffuse), np.array(material.specular), material.roughness)
        case GgxMaterial():
            return ggx(np.array(material.diffuse), np.array(material.normal_reflectance), material.roughness)
        case ProductMaterial():
            return _mean_of(folder / material.product)
        case MerlMaterial():
            return tabulated(read_merl(folder / material.merl).table)


def _mean_of(product: Path) -> Brdf:
    kind = kind_of(product)
    if kind not in _MEANS:
        raise ImageError(f"{product}: a product `{kind}` has no mean to relight by; {' and '.join(_MEANS)} have.")
    return _MEANS[kind](product)
