"""Lobe and residual of as many texels as there are, block after block."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.materials.joint_lobe import fit_phong_beside_residual
from processing.materials.measurements import Measurements
from processing.materials.phong import PhongFit
from processing.materials.residual import ALIKE, ResidualEquations, ResidualFit, Weighting
from processing.materials.sample_geometry import SampleGeometry
from processing.products import Lobe, ResidualBasis

MOST_SAMPLES = 1 << 20  # per block and channel: with nine functions 200 MB of tables; a sphere under 12 lights is one
_TEXELS_FOR_MISFIT = 4096  # good to a percent


@dataclass(frozen=True, eq=False)
class Samples:
    """Where the samples come from: `take` gives those of some of `texels`; `for_lobe` are those that tell the lobe."""

    take: Callable[[NDArray[np.intp]], Measurements]
    texels: NDArray[np.intp]
    for_lobe: Measurements

    def blocks(self) -> list[NDArray[np.intp]]:
        """The texels in parts of at most `MOST_SAMPLES` samples."""
        largest = max(MOST_SAMPLES // max(len(self.for_lobe.value), 1), 1)
        return [self.texels[start : start + largest] for start in range(0, len(self.texels), largest)]


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """What is to be fitted; without a `lobe` one is found beside the residuals."""

    lobe: Lobe | None
    basis: ResidualBasis
    rank_tolerance: float

    def equations(self, measurements: Measurements, weighting: Weighting) -> ResidualEquations:
        """Those of the residual."""
        geometry = SampleGeometry.of(measurements, self.basis)
        return ResidualEquations.of(measurements, geometry, weighting, self.rank_tolerance)


@dataclass(frozen=True, eq=False)
class TexelFits:
    """The lobe, its fit where it was not given, and the `residual` of all texels."""

    lobe: Lobe
    joint: PhongFit | None
    residual: ResidualFit


def fit_texels(samples: Samples, model: Model) -> TexelFits:
    """The lobe first, unless it is given, then every texel's residual."""
    blocks = samples.blocks()
    if model.lobe is not None:
        weighting = _weighting(samples, model, model.lobe)
        equations = (model.equations(samples.take(block), weighting) for block in blocks)
        return TexelFits(model.lobe, None, _residual(equations, model.lobe))
    joint = fit_phong_beside_residual(samples.for_lobe, model.basis, model.rank_tolerance)
    if len(blocks) == 1 and samples.for_lobe.value.shape[1] == len(samples.texels):
        equations = (one for one in [joint.equations])
    else:
        equations = (model.equations(samples.take(block), joint.weighting) for block in blocks)
    return TexelFits(joint.lobe.phong, joint.lobe, _residual(equations, joint.lobe.phong))


def _residual(equations: Iterable[ResidualEquations], lobe: Lobe) -> ResidualFit:
    k = np.stack([lobe.diffuse, lobe.specular])
    return ResidualFit.joined([one.fit(one.geometry.power(lobe), k) for one in equations])


def _weighting(samples: Samples, model: Model, lobe: Lobe) -> Weighting:
    """By the noise and by what the lobe and residuals of some texels, all samples counted alike, do not follow."""
    texels = min(_TEXELS_FOR_MISFIT, max(MOST_SAMPLES // len(samples.for_lobe.value), 1))
    few = samples.take(samples.texels[:: max(len(samples.texels) // texels, 1)])
    alike = model.equations(few, ALIKE)
    return Weighting(True, alike.misfit(few, alike.geometry.power(lobe), np.stack([lobe.diffuse, lobe.specular])))
