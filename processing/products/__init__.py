"""The result types, their files, and their plain NumPy `evaluate`: what every shader is held equal to."""

from processing.products.blinn_phong import BlinnPhong, half_vectors
from processing.products.directions import DirectionMesh
from processing.products.factored_btf import FactoredBtf
from processing.products.provenance import Provenance
from processing.products.srf import Srf
from processing.products.texture import bilinear_taps

__all__ = [
    "BlinnPhong",
    "DirectionMesh",
    "FactoredBtf",
    "Provenance",
    "Srf",
    "bilinear_taps",
    "half_vectors",
]
