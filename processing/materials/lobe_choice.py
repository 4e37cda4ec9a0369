"""Whether a material's lobe is drawn out, by how well it says directions that it was not fitted to."""

from dataclasses import dataclass

from processing.materials.anisotropic import fit_anisotropic_beside_residual
from processing.materials.basis_choice import CLOSE, choose_basis
from processing.materials.measurements import Measurements
from processing.materials.texel_fits import MOST_SAMPLES
from processing.products import AnisotropicPhong, ResidualBasis


@dataclass(frozen=True, slots=True, eq=False)
class LobeChoice:
    """The anisotropic `lobe`, None where a round one does as well, and the errors of both at directions left out.

    Errors are as in `BasisChoice`; NaN where `fit_anisotropic_beside_residual` found no anisotropy to try.
    """

    lobe: AnisotropicPhong | None
    error: float
    round_error: float


def choose_lobe(measurements: Measurements, basis: ResidualBasis) -> LobeChoice:
    """Find the anisotropic lobe beside the residuals, on evenly spread texels, and keep it where it foretells better.

    Better is by more than the 2 % by which bases are told apart: over millions of samples even what no lobe can follow
    makes a gain that chance does not. Raises ImageError as `choose_basis`.
    """
    few = measurements.thinned(MOST_SAMPLES)
    fit = fit_anisotropic_beside_residual(few, basis)
    if not isinstance(fit.lobe, AnisotropicPhong):
        return LobeChoice(None, float("nan"), float("nan"))
    error, round_error = (choose_basis(few, lobe, [basis]).errors[basis] for lobe in (fit.lobe, fit.round_lobe))
    return LobeChoice(fit.lobe if CLOSE * error < round_error else None, error, round_error)
