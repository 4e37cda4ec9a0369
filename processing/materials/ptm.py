"""Relightable images by least squares: polynomial texture maps and hemispherical harmonics.

Every pixel's display values under known lights become a sum of a few functions of the light's direction. The lights are
the same for all pixels, so one matrix solves them all; pixels that lack lights are solved from those that they have.
"""

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.materials import ptm_kernel
from processing.products import (
    Btf,
    LightStack,
    ReflectanceMaps,
    RelightableImage,
    ResidualBasis,
    StoredBtf,
    bilinear_taps,
    sphere_uv,
)
from processing.products.arrays import Float32, Float64
from processing.products.relightable_image import evaluate_basis, metric
from processing.products.sphere import gradient_grid
from processing.radiometry.display import srgb

# Smaller shares of the largest singular value count as 0. Between 0.02 and 0.03, photographs of a public gray sphere
# under twelve lights close together are told best from the other eleven; lights from all sides have none that small.
RANK_TOLERANCE = 0.02
_WHITE = 99.5  # percentile of the values that are shown as white, as in `radiometry.display`
_SURVEYED = 1_000_000  # values that tell it to a hundredth of a percent

_MAPPED_HALF_WIDTH = np.sqrt(0.5) - 1e-6  # radii: n_x at p = 1, q = 0; within 1 along the diagonal too
_STACK_FROM_SPHERE = np.array([1.0, -1.0, -1.0])  # y up and z toward the camera, from y down and z away from it

Values = NDArray[np.uint8] | NDArray[np.uint16] | Float32


class PtmStatus(IntEnum):
    """How a pixel was fitted; the worst of its channels."""

    FITTED = ptm_kernel.FITTED
    RANK_DEFICIENT = ptm_kernel.RANK_DEFICIENT  # its lights leave a coefficient open: the shortest solution
    TOO_FEW = ptm_kernel.TOO_FEW  # fewer values than coefficients: the shortest solution
    NO_VALUES = ptm_kernel.NO_VALUES  # black


@dataclass(frozen=True, eq=False)
class PtmFit:
    """A relightable image, the rank of its system where no light is missing, and a `PtmStatus` (y, x) per pixel."""

    image: RelightableImage
    rank: int
    status: NDArray[np.uint8]


def fit_ptm(values: Values, lights: Float64, basis: ResidualBasis = ResidualBasis.BIQUADRATIC) -> PtmFit:
    """Least squares per pixel and channel of display values (light, y, x, 3) over unit directions `lights` (light, 3).

    Counts of 8 or 16 bits are shares of the largest code; float32 is taken as it is, with NaN where a light is missing.
    Where the lights leave a combination of coefficients open, as those of one arc do, the shortest solution is taken.
    Source: Malzbender et al. 2001, 3.1. Raises ImageError where shapes or types do not fit.
    """
    if values.ndim != 4 or values.shape[::3] != (len(lights), 3):
        raise ImageError(f"pictures under {len(lights)} lights are (light, y, x, 3), not {values.shape}")
    white = _white(values)
    functions = evaluate_basis(basis, np.asarray(lights, np.float64))
    columns: NDArray[Any] = values.reshape(len(values), -1)
    out = np.empty((basis.size, columns.shape[1]), np.float32)
    ptm_kernel.apply(columns, _solving_matrix(functions, white), out)
    rank = int(np.linalg.matrix_rank(functions, rtol=RANK_TOLERANCE))
    status = np.full(values.shape[1:3], _status(rank, functions), np.uint8)
    if values.dtype == np.float32:
        by_value = np.repeat(status.ravel(), 3)
        ptm_kernel.solve_gaps(columns, functions, RANK_TOLERANCE, out, by_value)
        status = by_value.reshape(values.shape[1:]).max(axis=-1)
    image = RelightableImage(out.reshape(basis.size, *values.shape[1:]), basis, lights=np.asarray(lights, np.float64))
    return PtmFit(image, rank, status)


def stack_pictures(stack: LightStack) -> tuple[Float32, Float64]:
    """Display values (light, y, x, 3) of what a camera saw, and one direction (light, 3) for each.

    A near light has the direction from the picture's middle.
    """
    return display_values(stack.reflectance_cos), stack.light_directions


def btf_pictures(btf: Btf | StoredBtf) -> tuple[Float32, Float64]:
    """Display values (light, y, x, 3) of a BTF in the view nearest the normal, and the lights' directions."""
    view = int(np.argmax(btf.view_directions[:, 2]))
    cosines = np.maximum(btf.light_directions[:, 2], 0.0).astype(np.float32)
    return display_values(btf.seen_from(view) * cosines[:, None, None, None]), btf.light_directions


def map_pictures(maps: ReflectanceMaps) -> tuple[Float32, Float64]:
    """Display values (light, y, x, 3) of a sphere's mapped part as its camera sees it, and the lights' directions.

    Seen orthographically, as many pixels wide as the maps; beyond p, q = +-1 is NaN.
    """
    size = maps.reflectance_cos.shape[1]
    x, y = np.meshgrid(*[gradient_grid(size) * _MAPPED_HALF_WIDTH] * 2)
    uv = sphere_uv(np.stack([x, y, -np.sqrt(1 - x * x - y * y)], axis=-1))
    inside = (np.abs(uv - 0.5) <= 0.5).all(axis=-1)
    rows, columns, taps = bilinear_taps(uv[inside], size, size, wrap=False)
    seen = np.full(maps.reflectance_cos.shape, np.nan, np.float32)
    seen[:, inside] = np.einsum("nt,lntc->lnc", taps, maps.reflectance_cos[:, rows, columns])
    return display_values(seen), maps.light_directions * _STACK_FROM_SPHERE


def display_values(linear: Float32) -> Float32:
    """sRGB-encoded values of linear ones of any scale, 99.5 % of them under 1; NaN stays."""
    every = max(1, round(float(np.sqrt(linear.size / _SURVEYED))))
    seen = linear[:, ::every, ::every]
    lit = seen[np.isfinite(seen) & (seen > 0)]
    white = float(np.percentile(lit, _WHITE)) if lit.size else 1.0
    return srgb(linear / np.float32(white)).astype(np.float32)


def as_lrgb(image: RelightableImage) -> RelightableImage:
    """The nearest image of one colour per pixel times a luminance, in the mean square over the image's lights.

    A half of the size and no change of hue with the light. The colour is the first left singular vector of a pixel's
    coefficients (channel, k) in the lights' metric, its largest channel 1.
    """
    if image.colour is not None:
        return image
    coefficients = np.moveaxis(image.coefficients.astype(np.float64), 0, -1)  # (y, x, channel, k)
    products = coefficients @ metric(image.basis, image.lights) @ np.swapaxes(coefficients, -1, -2)
    colour = np.abs(np.linalg.eigh(products)[1][..., -1])
    luminance = np.einsum("yxc,yxck->kyx", colour, coefficients)
    peak = colour.max(axis=-1)
    return replace(
        image,
        coefficients=(luminance * peak)[..., None].astype(np.float32),
        colour=(colour / peak[..., None]).astype(np.float32),
    )


def reproduction_db(image: RelightableImage, values: Values, lights: Float64) -> float:
    """Peak signal-to-noise ratio of the image against what it was fitted to, clipped as a display clips it."""
    white = np.float32(_white(values))
    squares = count = 0.0
    for picture, light in zip(values, lights, strict=True):
        error = np.clip(image.evaluate(light), 0, 1) - np.minimum(picture / white, 1)
        squares += float(np.nansum(error * error, dtype=np.float64))
        count += float(np.isfinite(error).sum())
    return float(-10 * np.log10(squares / count)) if squares > 0 else float("inf")


def _white(values: Values) -> float:
    """What stands for white; raises ImageError for numbers that are no pictures."""
    white = {np.dtype(np.uint8): 255.0, np.dtype(np.uint16): 65535.0, np.dtype(np.float32): 1.0}.get(values.dtype)
    if white is None:
        raise ImageError(f"display values are 8 or 16 bits or float32, not {values.dtype}")
    return white


def _solving_matrix(functions: Float64, white: float) -> Float32:
    """Coefficients of values in units of 1 / `white`: (k, light), with zeros up to whole groups of lights."""
    matrix = np.linalg.pinv(functions, rcond=RANK_TOLERANCE) / white
    return np.pad(matrix, ((0, 0), (0, -len(functions) % ptm_kernel.TOGETHER))).astype(np.float32)


def _status(rank: int, functions: Float64) -> PtmStatus:
    lights, size = functions.shape
    if rank == size:
        return PtmStatus.FITTED
    return PtmStatus.TOO_FEW if lights < size else PtmStatus.RANK_DEFICIENT
