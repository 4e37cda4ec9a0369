"""The result types, their files, and their plain NumPy `evaluate`: what every shader is held equal to."""

from processing.products.blinn_phong import AnisotropicPhong, BlinnPhong, Lobe, half_vectors
from processing.products.btf import Btf, StoredBtf
from processing.products.directions import DirectionMesh
from processing.products.factored_btf import FactoredBtf
from processing.products.lafortune import LafortuneTexels
from processing.products.light_environment import Environment
from processing.products.light_stack import LightStack, plane_points
from processing.products.mdf import Mdf, unpack8
from processing.products.mesostructure import Mesostructure
from processing.products.normal_map import NormalMap, NormalStatus
from processing.products.provenance import Provenance
from processing.products.reflectance_maps import ReflectanceMaps
from processing.products.relightable_image import RelightableImage
from processing.products.residual_basis import ResidualBasis
from processing.products.sbrdf_plus import SbrdfPlus
from processing.products.sphere import normals_of, sphere_normals, sphere_uv, tangent_frames
from processing.products.srf import Srf
from processing.products.texture import bilinear_taps

__all__ = [
    "AnisotropicPhong",
    "BlinnPhong",
    "Btf",
    "DirectionMesh",
    "Environment",
    "FactoredBtf",
    "LafortuneTexels",
    "LightStack",
    "Lobe",
    "Mdf",
    "Mesostructure",
    "NormalMap",
    "NormalStatus",
    "Provenance",
    "ReflectanceMaps",
    "RelightableImage",
    "ResidualBasis",
    "SbrdfPlus",
    "Srf",
    "StoredBtf",
    "bilinear_taps",
    "half_vectors",
    "normals_of",
    "plane_points",
    "sphere_normals",
    "sphere_uv",
    "tangent_frames",
    "unpack8",
]
