"""Which residual basis a session's SRF gets."""

import numpy as np
from numpy.typing import NDArray

from processing.materials.basis_choice import choose_basis
from processing.materials.measurements import Measurements
from processing.products import ResidualBasis
from service.pipeline.inputs import Progress

_LEAST_LIGHTS = 24  # two for each function of the largest basis, in what a fold leaves
_FLAT = 0.05  # smallest over largest singular value of light directions that lie in one plane


def basis_for(measurements: Measurements, light_directions: NDArray[np.floating], progress: Progress) -> ResidualBasis:
    """By cross-validation over the lights (light, 3), and told; of few lights, or lights in one plane, s . H.

    Those in one plane with the camera, as on the arm, determine two numbers per texel and so no larger basis.
    """
    spread = np.linalg.svd(light_directions, compute_uv=False)
    if len(light_directions) < _LEAST_LIGHTS or spread[-1] < _FLAT * spread[0]:
        return ResidualBasis.HALF
    choice = choose_basis(measurements)
    share = choice.errors[choice.basis] / choice.errors[ResidualBasis.HALF]
    progress.note(f"residual basis {choice.basis}: {share:.2f} of the error of half at lights that were left out")
    return choice.basis
