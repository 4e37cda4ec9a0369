"""Which lobe and which residual basis a session's SRF gets."""

import numpy as np
from numpy.typing import NDArray

from processing.materials.basis_choice import choose_basis
from processing.materials.lobe_choice import choose_lobe
from processing.materials.measurements import Measurements
from processing.products import Lobe, ResidualBasis
from service.pipeline.inputs import Progress

_LEAST_LIGHTS = 24  # two for each function of the largest basis, in what a fold leaves
_FLAT = 0.05  # smallest over largest singular value of light directions that lie in one plane


def model_for(
    measurements: Measurements, light_directions: NDArray[np.floating], progress: Progress
) -> tuple[Lobe | None, ResidualBasis]:
    """By cross-validation over the lights (light, 3), and told; no lobe: a round one, to be found with the residual.

    Few lights, or lights in one plane, get that and s . H: those in one plane with the camera, as on the arm, determine
    two numbers per texel, and so neither a larger basis nor how a lobe changes across them.
    """
    spread = np.linalg.svd(light_directions, compute_uv=False)
    if len(light_directions) < _LEAST_LIGHTS or spread[-1] < _FLAT * spread[0]:
        return None, ResidualBasis.HALF
    choice = choose_basis(measurements, bases=progress.track(ResidualBasis, "choosing the residual basis"))
    half = choice.errors[ResidualBasis.HALF]
    share = choice.errors[choice.basis] / half if half > 0 else 1.0  # nothing is left over of what is black
    progress.note(f"residual basis {choice.basis}: {share:.2f} of the error of half at lights that were left out")
    tries = progress.track([choice.basis], "trying an anisotropic lobe")
    (tried,) = [choose_lobe(measurements, basis) for basis in tries]
    if tried.lobe is not None:
        share = tried.error / tried.round_error
        progress.note(f"anisotropic lobe: {share:.2f} of the error of a round one at lights that were left out")
    return tried.lobe, choice.basis
