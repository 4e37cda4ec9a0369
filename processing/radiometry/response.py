"""The response curve of a camera that delivers 8-bit pictures, recovered from a bracketed stack."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.robust import weighted_median_place

Array = NDArray[np.float64]
CODES = 256
FOOT, SHOULDER = 3, 252  # codes outside are clipped or touched by it: JPEG rings by a few codes
_FIT_FROM = 12  # below, the noise of a code is no longer small against the code
_TAPER = 10.0  # codes over which a sample's weight rises from none
_DEGREE = 5
_ROUNDS = 12
_HUBER = 2.0


@dataclass(frozen=True, slots=True)
class Response:
    """`log_exposure` (256,): ln(radiance * time) of every code, 0 at code 128; `code_sigma_dn`: noise of a code."""

    log_exposure: Array
    code_sigma_dn: float

    @property
    def slope(self) -> Array:
        """Change of log exposure per code (256,)."""
        return np.asarray(np.gradient(self.log_exposure), np.float64)


def code_weight(lowest: int = FOOT) -> Array:
    """Trust in each code (256,): none where clipped, full ten codes away from there."""
    code = np.arange(CODES, dtype=np.float64)
    return np.clip(np.minimum(code - lowest + 1, SHOULDER + 1 - code) / _TAPER, 0, 1)


def srgb_log_exposure() -> Array:
    """Logarithm of linear light (256,) of the sRGB curve (IEC 61966-2-1); code 0 taken as half a code."""
    x = np.maximum(np.arange(CODES), 0.5) / 255
    return np.asarray(np.log(np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)), np.float64)


def recover_response(stack: NDArray[np.uint8], exposure_s: Array) -> Response:
    """Response g with g(128) = 0, increasing, such that ln(radiance * time) = g(code), and the noise of a code.

    `stack` (k, ...) holds the same scene with different times; all channels share one curve, so that grey stays grey.
    As Debevec and Malik 1997, but with every pixel, by the joint histogram of each pair of exposures, and with g as
    the sRGB curve plus a polynomial of degree five: with exposures in one constant ratio a free curve is determined
    only up to a periodic part, and its smoothness term must choose; real curves lie near sRGB. Residuals count by
    the slope of g and linearly beyond two deviations (Huber), since clouds move and leaves shake.
    Raises ImageError where no pair of exposures overlaps or the curve found does not increase.
    """
    cells = _joint_cells(stack, exposure_s)
    x = np.arange(CODES) / (CODES - 1)
    basis = np.stack([x**n for n in range(1, _DEGREE + 1)], axis=1)
    start = srgb_log_exposure()
    coefficients, sigma_dn = _robust_fit(cells, start, basis - basis[128])
    curve = start - start[128] + (basis - basis[128]) @ coefficients
    if not (np.diff(curve) > 0).all():
        raise ImageError("no increasing response fits the photographs; were they taken of the same scene and framing?")
    return Response(np.asarray(curve, np.float64), sigma_dn)


_Cells = tuple[NDArray[np.intp], NDArray[np.intp], Array, Array]


def _joint_cells(stack: NDArray[np.uint8], exposure_s: Array) -> _Cells:
    """Code in one exposure, code in another, log ratio of their times, and weighted count of pixels with both."""
    weight = code_weight(_FIT_FROM)
    parts: list[_Cells] = []
    for i in range(len(stack)):
        for j in range(i + 1, len(stack)):
            joint = np.bincount(stack[i].ravel().astype(np.intp) * CODES + stack[j].ravel(), minlength=CODES**2)
            count = joint.reshape(CODES, CODES) * np.outer(weight, weight)
            one, other = np.nonzero(count)
            ratio = np.full(len(one), np.log(exposure_s[j] / exposure_s[i]))
            parts.append((one, other, ratio, count[one, other]))
    if sum(len(part[0]) for part in parts) < 10 * _DEGREE:
        raise ImageError("no two exposures overlap: every pixel is clipped in all but one. Take them closer together.")
    ones, others, ratios, counts = zip(*parts, strict=True)
    return np.concatenate(ones), np.concatenate(others), np.concatenate(ratios), np.concatenate(counts)


def _robust_fit(cells: _Cells, start: Array, basis: Array) -> tuple[Array, float]:
    one, other, ratio, count = cells
    design = basis[other] - basis[one]
    wanted = ratio - (start[other] - start[one])
    coefficients = np.zeros(basis.shape[1])
    huber = np.ones(len(count))
    for _ in range(_ROUNDS):
        slope = np.maximum(np.gradient(start + basis @ coefficients), 1e-3)
        variance = slope[one] ** 2 + slope[other] ** 2
        weight = count * huber / variance
        normal = design.T @ (weight[:, None] * design)
        normal += 1e-6 * np.trace(normal) * np.eye(len(normal))
        coefficients = np.linalg.solve(normal, design.T @ (weight * wanted))
        size = np.abs(wanted - design @ coefficients) / np.sqrt(variance)
        sigma_dn = 1.4826 * float(size[weighted_median_place(size, count)[0]])
        huber = np.minimum(1, _HUBER * sigma_dn / np.maximum(size, 1e-9))
    # Rounding alone is 0.29 of a code; a stack of equal codes would claim less.
    return np.asarray(coefficients, np.float64), max(sigma_dn, 0.29)
