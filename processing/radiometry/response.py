"""The response curve of a camera that delivers 8-bit pictures, recovered from a bracketed stack."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from processing.errors import ImageError
from processing.radiometry import response_kernel
from processing.radiometry.display import linear_of_srgb
from processing.radiometry.response_fit import (
    JUDGED_FRAMES,
    MIDDLE,
    Equations,
    Smooth,
    believed_times,
    code_noise,
    smooth_curves,
    spline_basis,
)
from processing.robust import weighted_median_place

Array = NDArray[np.float64]
CODES = response_kernel.CODES
_FIT = 10, 240  # codes outside take no part in the fit: their noise is no longer small against what clips them
_PIXELS = 60_000  # as many decide about the curve
_TILES = 3, 4
_ROUNDS, _CLIMBING = 10, 4
_GRID = 4000
_STILL = 5e-4  # change of log exposure that ends the rounds
# Of a stated exposure, to begin with; of few, which no smoothness of the curve may change.
_TIME_SIGMA = 0.003, 0.001
_SLOPE = 0.2  # of the start's: no round may flatten the curve further
# Of the log exposure: JPEG averages codes over texture, and a bent curve does not commute with that. Measured on the
# simulated camera.
_MIXING = 0.0015
_NO_RESPONSE = (
    "no response fits the photographs: they differ by more than exposure (another scene or framing), or show too few "
    "shades to tell. Give a response saved from another bracket of this camera."
)
_NOISIEST_DN = 12.0  # codes: no camera's noise, but pictures that do not agree
_START_DEGREE, _START_ROUNDS, _START_HUBER = 5, 12, 2.0


@dataclass(frozen=True, slots=True)
class Response:
    """How a camera turns exposure into codes; every table is (256, channels).

    `log_exposure`: ln of the exposure of a code, rising, 0 at code 128. `log_exposure_sigma`: its standard deviation,
    the same error for every pixel. `code_sigma_dn`: noise of one sample in codes; `coding_sigma_dn` (channels,): the
    part of it that arises after the curve. `camera`: the model, empty where unknown.
    """

    log_exposure: Array
    log_exposure_sigma: Array
    code_sigma_dn: Array
    coding_sigma_dn: Array
    camera: str = ""

    @property
    def slope(self) -> Array:
        """Change of log exposure per code (256, channels)."""
        return np.asarray(np.gradient(self.log_exposure, axis=0), np.float64)

    @property
    def light(self) -> Array:
        """Linear exposure (256, channels) whose mean over the noise is right.

        Noise that comes after a bent curve raises the mean light by half the second derivative times its variance;
        that is subtracted.
        """
        return _unbiased(np.exp(self.log_exposure), self.coding_sigma_dn)


def _unbiased(light: Array, sigma_dn: Array) -> Array:
    bend = np.gradient(np.gradient(light, axis=0), axis=0)
    bend[[0, 1, -2, -1]] = bend[[2, 2, -3, -3]]
    return np.asarray(np.maximum(light - 0.5 * bend * sigma_dn**2, 0.1 * light), np.float64)


def srgb_log_exposure() -> Array:
    """Logarithm of linear light (256,) of the sRGB curve (IEC 61966-2-1); code 0 taken as half a code."""
    x = np.maximum(np.arange(CODES), 0.5) / 255
    return np.asarray(np.log(linear_of_srgb(x)), np.float64)


def recover_response(stack: NDArray[np.uint8], exposure: Array) -> tuple[Response, Array]:
    """Response g of each channel, g(128) = 0, such that ln(radiance * exposure) = g(code), and log-time errors (k,).

    `stack` (k, h, w, channels) holds the same scene at different exposures. As Debevec and Malik 1997, but with all
    pixels (thinned to some ten thousand), each with its radiance eliminated and its samples weighed by variance, and
    with g as the sRGB curve plus a spline whose smoothness the evidence chooses: with exposures in one constant ratio
    a free curve is determined only up to a periodic part. Channels share a curve as far as the data say so. Fewer than
    four exposures cannot be judged: the curve goes by them as stated, and its deviation allows for labels 4 % off.
    Raises ImageError where no pair of exposures overlaps or the curve found does not increase.
    """
    pixels, tile = _samples(stack)
    channels, frames = stack.shape[-1], len(stack)
    basis, start = spline_basis(), _start(stack, exposure)
    nominal = srgb_log_exposure() - srgb_log_exposure()[MIDDLE]
    present = np.repeat(np.linalg.lstsq(basis, start - nominal, rcond=None)[0][None], channels, axis=0)
    covariance = np.zeros((*present.shape, present.shape[1]))
    time_sigma = np.full(frames, _TIME_SIGMA[frames < JUDGED_FRAMES])
    fit = Smooth(present, covariance, np.zeros(frames), time_sigma)
    noise = np.ones((CODES, channels)), np.ones(channels)
    floor = _SLOPE * np.gradient(start)
    for i in range(_ROUNDS):
        curves = _rising(nominal[:, None] + basis @ fit.coefficients.T, floor)
        equations, noise = _round(pixels, tile, np.log(exposure) + fit.log_time, curves, noise, basis)
        last, fit = fit, smooth_curves(equations, fit, climb=i < _CLIMBING)
        if i >= _CLIMBING:  # else the ends may swing between two states
            fit = replace(fit, coefficients=0.5 * (fit.coefficients + last.coefficients))
        if np.abs(basis[_FIT[0] : _FIT[1]] @ (fit.coefficients - last.coefficients).T).max() < _STILL:
            break
    curves = nominal[:, None] + basis @ fit.coefficients.T
    if not (np.diff(curves[_FIT[0] : _FIT[1]], axis=0) > 0).all() or np.median(noise[0]) > _NOISIEST_DN:
        raise ImageError(_NO_RESPONSE)
    curves = _rising(curves, floor)  # where it is extrapolated
    variance = np.einsum("zi,cij,zj->zc", basis, fit.covariance, basis) + (_MIXING * curves) ** 2
    return Response(curves, np.sqrt(variance), *noise), fit.log_time


def _rising(curves: Array, floor: Array) -> Array:
    steps = np.maximum(np.diff(curves, axis=0), floor[1:, None])
    rising = np.concatenate([np.zeros((1, curves.shape[1])), np.cumsum(steps, axis=0)])
    return np.asarray(rising - rising[MIDDLE], np.float64)


def _samples(stack: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], NDArray[np.intp]]:
    """Codes (channels, n, k) of smooth pixels spread over the picture, and the image tile of each."""
    height, width = stack.shape[1:3]
    kernel = np.ones((5, 5), np.uint8)
    edge = np.zeros((height, width), np.uint8)
    for frame in stack:
        span = cv2.dilate(frame, kernel) - cv2.erode(frame, kernel)
        np.maximum(edge, span.reshape(height, width, -1).max(axis=-1), out=edge)
    keep = edge <= max(np.median(edge), 12)
    rows, columns = np.nonzero(keep)
    step = max(len(rows) // _PIXELS, 1)
    rows, columns = rows[::step], columns[::step]
    tile = rows * _TILES[0] // height * _TILES[1] + columns * _TILES[1] // width
    return np.ascontiguousarray(stack[:, rows, columns].transpose(2, 1, 0)), tile


def _round(
    pixels: NDArray[np.uint8],
    tile: NDArray[np.intp],
    log_exposure: Array,
    curves: Array,
    noise: tuple[Array, Array],
    basis: Array,
) -> tuple[list[Equations], tuple[Array, Array]]:
    """Normal equations of each channel at these curves, and the noise that the residuals show."""
    unknowns = block_diag(basis, np.eye(len(log_exposure)))
    equations, sigmas, codings = [], [], []
    for codes, curve, sigma_dn, coding_dn in zip(pixels, curves.T, noise[0].T, noise[1], strict=True):
        parts = _tile_equations(codes, tile, log_exposure, (curve, sigma_dn, coding_dn))
        half = np.tensordot(np.stack([part[0] for part in parts]), unknowns, axes=(2, 0))
        matrix = np.tensordot(unknowns, half, axes=(0, 1)).transpose(1, 0, 2)
        equations.append(Equations(matrix, np.stack([part[1] for part in parts]) @ unknowns))
        sigma, coding = code_noise(np.sum([part[2] for part in parts], axis=0), sigma_dn, np.exp(curve))
        sigmas.append(sigma)
        codings.append(coding)
    return equations, (np.stack(sigmas, axis=1), np.array(codings))


def _tile_equations(
    codes: NDArray[np.uint8], tile: NDArray[np.intp], log_exposure: Array, channel: tuple[Array, Array, float]
) -> list[tuple[Array, Array, Array]]:
    """`response_kernel.normal_equations` of every image tile; `channel`: curve, noise of a code, its coding part."""
    curve, sigma_dn, coding_dn = channel
    weight = 1 / (np.gradient(curve) * sigma_dn) ** 2
    weight[: _FIT[0]] = weight[_FIT[1] :] = 0
    at = np.interp(np.linspace(curve[0], curve[-1], _GRID + 1), curve, np.arange(CODES))
    grid = float(curve[0]), float(_GRID / (curve[-1] - curve[0])), np.rint(at).astype(np.intp)
    light = _unbiased(np.exp(curve)[:, None], np.array([coding_dn]))[:, 0]
    return [
        response_kernel.normal_equations(codes[tile == t], log_exposure, light, weight, grid)
        for t in range(_TILES[0] * _TILES[1])
    ]


def exposure_errors(stack: NDArray[np.uint8], exposure: Array, response: Response) -> Array:
    """By how much more each frame (k,) was exposed than stated, as a logarithm, under a known response.

    Zero but for frames that the others contradict. Raises ImageError where the channels do not fit the response.
    """
    pixels, tile = _samples(stack)
    log_time, time_sigma = np.zeros(len(exposure)), np.full(len(exposure), _TIME_SIGMA[0])
    for _ in range(_ROUNDS):
        equations = []
        for c, codes in enumerate(pixels):
            channel = response.log_exposure[:, c], response.code_sigma_dn[:, c], float(response.coding_sigma_dn[c])
            parts = _tile_equations(codes, tile, np.log(exposure) + log_time, channel)
            matrix = np.stack([part[0][CODES:, CODES:] for part in parts])
            equations.append(Equations(matrix, np.stack([part[1][CODES:] for part in parts])))
        last, (log_time, time_sigma) = log_time, believed_times(equations, log_time, time_sigma)
        if np.abs(log_time - last).max() < _STILL:
            break
    return log_time


def _start(stack: NDArray[np.uint8], exposure: Array) -> Array:
    """A first curve (256,) of all channels: sRGB plus a polynomial, by the joint histogram of each pair of frames.

    Linear in its unknowns: it starts from nowhere. Raises ImageError where no two exposures overlap.
    """
    cells = _joint_cells(stack, exposure)
    x = np.arange(CODES) / (CODES - 1)
    nominal = srgb_log_exposure()
    for degree in range(_START_DEGREE, 0, -1):  # fewer where a few overlapping codes would bend it back
        basis = np.stack([x**n - x[MIDDLE] ** n for n in range(1, degree + 1)], axis=1)
        curve = nominal - nominal[MIDDLE] + basis @ _robust_fit(cells, nominal, basis)
        if (np.diff(curve) > 0).all():
            return np.asarray(curve, np.float64)
    raise ImageError(_NO_RESPONSE)


def _hat() -> Array:
    code = np.arange(CODES, dtype=np.float64)
    return np.clip(np.minimum(code - 11, 253 - code) / 10, 0, 1)


_Cells = tuple[NDArray[np.intp], NDArray[np.intp], Array, Array]


def _joint_cells(stack: NDArray[np.uint8], exposure_s: Array) -> _Cells:
    """Code in one exposure, code in another, log ratio of their times, and weighted count of pixels with both."""
    weight = _hat()
    parts: list[_Cells] = []
    for i in range(len(stack)):
        for j in range(i + 1, len(stack)):
            joint = np.bincount(stack[i].ravel().astype(np.intp) * CODES + stack[j].ravel(), minlength=CODES**2)
            count = joint.reshape(CODES, CODES) * np.outer(weight, weight)
            one, other = np.nonzero(count)
            ratio = np.full(len(one), np.log(exposure_s[j] / exposure_s[i]))
            parts.append((one, other, ratio, count[one, other]))
    if sum(len(part[0]) for part in parts) < 10 * _START_DEGREE:
        raise ImageError("no two exposures overlap: every pixel is clipped in all but one. Take them closer together.")
    ones, others, ratios, counts = zip(*parts, strict=True)
    return np.concatenate(ones), np.concatenate(others), np.concatenate(ratios), np.concatenate(counts)


def _robust_fit(cells: _Cells, start: Array, basis: Array) -> Array:
    one, other, ratio, count = cells
    design = basis[other] - basis[one]
    wanted = ratio - (start[other] - start[one])
    coefficients = np.zeros(basis.shape[1])
    huber = np.ones(len(count))
    for _ in range(_START_ROUNDS):
        slope = np.maximum(np.gradient(start + basis @ coefficients), 1e-3)
        variance = slope[one] ** 2 + slope[other] ** 2
        weight = count * huber / variance
        normal = design.T @ (weight[:, None] * design)
        normal += 1e-6 * np.trace(normal) * np.eye(len(normal))
        coefficients = np.linalg.solve(normal, design.T @ (weight * wanted))
        size = np.abs(wanted - design @ coefficients) / np.sqrt(variance)
        sigma_dn = 1.4826 * float(size[weighted_median_place(size, count)[0]])
        huber = np.minimum(1, _START_HUBER * sigma_dn / np.maximum(size, 1e-9))
    return np.asarray(coefficients, np.float64)
