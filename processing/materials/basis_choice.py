"""Which residual basis a material needs, by how well each says directions that it was not fitted to."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.materials.measurements import Measurements
from processing.materials.residual import RANK_TOLERANCE
from processing.materials.sample_geometry import SampleGeometry
from processing.materials.texel_fits import Model, Samples, fit_texels
from processing.products import Lobe, ResidualBasis

_MOST_SAMPLES = 1 << 16  # per channel: thousands of texels under an arm's lights, ten under all pairs of a BTF
CLOSE = 1.02  # errors within 2 % of the least are no reason for a larger texture
_GOLDEN = (np.sqrt(5) - 1) / 2


@dataclass(frozen=True, slots=True, eq=False)
class BasisChoice:
    """The `basis` of fewest functions whose error is within 2 % of the least, and the `errors` of all that were tried.

    An error is the mean square over all samples, each predicted from directions that it is not among, noise included;
    in the unit of the samples, squared.
    """

    basis: ResidualBasis
    errors: Mapping[ResidualBasis, float]


def choose_basis(
    measurements: Measurements,
    lobe: Lobe | None = None,
    bases: Iterable[ResidualBasis] = tuple(ResidualBasis),
    folds: int = 4,
    rank_tolerance: float = RANK_TOLERANCE,
) -> BasisChoice:
    """Cross-validate over the directions, on evenly spread texels; without a `lobe` each fold finds its own.

    Each fold leaves out directions spread by the golden ratio, which takes neighbours in turn in any order of lights
    or of pairs. Raises ImageError where there are fewer directions than folds, or no sample.
    """
    count = len(measurements.value)
    if count < folds:
        raise ImageError(f"{count} directions cannot be left out in {folds} turns; measure more, or name the basis")
    few = measurements.thinned(_MOST_SAMPLES)
    fold = np.floor(np.arange(count) * _GOLDEN % 1 * folds)
    errors = {}
    for basis in bases:
        model = Model(lobe, basis, rank_tolerance)
        with _one_thread():
            sums = np.sum([_left_out(few, fold == turn, model) for turn in range(folds)], axis=0)
        if not sums[1] > 0:
            raise ImageError("no sample is lit and measured: nothing tells the bases apart; check lamps and exposures")
        errors[basis] = float(sums[0] / sums[1])
    least = min(errors.values())
    close = [basis for basis in errors if errors[basis] <= CLOSE * least]
    return BasisChoice(min(close, key=lambda basis: basis.size), errors)


@contextmanager
def _one_thread() -> Iterator[None]:
    """For hundreds of loops of a millisecond each: threads would wait for each other longer than they work."""
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(threads)


def _left_out(measurements: Measurements, out: NDArray[np.bool_], model: Model) -> tuple[float, int]:
    """Sum of squared errors at the directions that are left out, and the number of samples there."""
    kept, asked = (measurements.directions(np.flatnonzero(chosen)) for chosen in (~out, out))
    fits = fit_texels(Samples(kept.texels, np.arange(kept.value.shape[1]), kept), model)
    functions = SampleGeometry.of(asked, model.basis).basis
    functions = np.broadcast_to(functions, (kept.value.shape[1], *functions.shape[1:]))
    residual = np.einsum("tck,tkd->dtc", np.nan_to_num(fits.residual.coefficients), functions, optimize=True)
    valid = asked.valid
    error = np.where(valid, asked.delta(fits.lobe) - residual, 0.0)
    return float((error**2).sum()), int(valid.sum())
