"""From radiance to reflectance by the white frame around the sample."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from processing.cameras.calibration import CameraModel
from processing.cameras.rectification import Rectified, Texels, rectify
from processing.errors import ImageError
from processing.radiometry.hdr import Radiance
from processing.robust import biweight, bulk_deviation

Array = NDArray[np.float64]
_FRAME_TEXELS = 76  # over the outer side of the upper frame: about a millimetre, as wide as the edges' blur
_EDGE = 0.2  # of the frame's width on each side is left out: burrs, blur, calibration
_MIN_FRAME_TEXELS = 40  # for six coefficients that must also survive a shadow
_ROUNDS = 10
_DRAWS, _DRAWN = 150, 8  # with 35 % in shadow, five of 150 draws still miss it


@dataclass(frozen=True, slots=True)
class WhiteFrame:
    """The matt white upper frame in the plane of the sample's top: square, from `opening_m` to `outer_m`."""

    opening_m: float
    outer_m: float


@dataclass(frozen=True)
class WhiteRadiance:
    """What a white plate in the place of the sample would show: radiance over the plane z = 0 of the sample frame.

    A quadratic in x and y per channel; a point lamp at 0.6 m over a 60 mm sample departs from it by under 0.1 %.
    `coefficients` (3, 6), `covariance` (3, 6, 6), of 1 x y x^2 x y y^2 in units of `scale_m`.
    """

    coefficients: Array
    covariance: Array
    scale_m: float

    def radiance(self, points_m: NDArray[np.floating]) -> Array:
        """Radiance (..., 3) at sample-frame points (..., 3)."""
        return np.asarray(_quadratic(points_m, self.scale_m) @ self.coefficients.T, np.float64)

    def variance(self, points_m: NDArray[np.floating]) -> Array:
        """Variance (..., 3) of `radiance`."""
        terms = _quadratic(points_m, self.scale_m)
        return np.asarray(np.einsum("...i,cij,...j->...c", terms, self.covariance, terms), np.float64)


def white_frame_radiance(
    radiance: Radiance,
    camera: CameraModel,
    rig_from_sample: Array,
    frame: WhiteFrame,
    cfa: NDArray[np.uint8] | None = None,
) -> WhiteRadiance:
    """Radiance of the white upper frame, continued smoothly over the sample that it surrounds.

    A quadratic is fitted to the frame's texels, starting from the majority and with Tukey's biweight, so that what
    does not follow it takes no part: shadows over less than half of the frame, dust.
    Raises ImageError where too little of the frame is seen, or it is not lit.
    """
    texels = Texels(_FRAME_TEXELS, frame.outer_m)
    seen = rectify(radiance, camera, rig_from_sample, texels, cfa)
    points = texels.centres_m
    edge_m = _EDGE * (frame.outer_m - frame.opening_m) / 2
    across = np.abs(points[..., :2]).max(axis=-1)
    ring = seen.valid & (across > frame.opening_m / 2 + edge_m) & (across < frame.outer_m / 2 - edge_m)
    if np.count_nonzero(ring) < _MIN_FRAME_TEXELS:
        raise ImageError("the white frame is not in the image; check the camera's calibration and the exposures.")
    scale_m = frame.outer_m / 2
    terms = _quadratic(points[ring], scale_m)
    values = seen.value[ring].T.astype(np.float64)
    fits = [_robust_fit(terms, *pair) for pair in zip(values, _starts(terms, values), strict=True)]
    white = WhiteRadiance(np.stack([f[0] for f in fits]), np.stack([f[1] for f in fits]), scale_m)
    if not (white.radiance(points[ring]) > 0).all():
        raise ImageError("the white frame is dark; check the lamp and the exposures.")
    return white


def _quadratic(points_m: NDArray[np.floating], scale_m: float) -> Array:
    x, y = points_m[..., 0] / scale_m, points_m[..., 1] / scale_m
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)


def _starts(terms: Array, values: Array) -> Array:
    """Coefficients (c, 6) near the surface that most of the values (c, n) follow.

    Of fits to small subsets the one with the least median residual (Rousseeuw 1984): a shadow lies in one piece and
    would bend a fit that begins with all values.
    """
    draws = np.random.default_rng(0).integers(len(terms), size=(_DRAWS, _DRAWN))
    trials = np.einsum("dij,cdj->cdi", np.linalg.pinv(terms[draws]), values[:, draws])
    some = slice(None, None, 4)  # enough for a median
    residual = np.median(np.abs(values[:, None, some] - trials @ terms[some].T), axis=-1)
    return np.asarray(trials[np.arange(len(values)), residual.argmin(axis=1)], np.float64)


def _robust_fit(terms: Array, value: Array, coefficients: Array) -> tuple[Array, Array]:
    """Coefficients and covariance of the surface that most values follow, from a start near it."""
    for _ in range(_ROUNDS):
        residual = value - terms @ coefficients
        spread = max(bulk_deviation(residual), 1e-6 * float(np.abs(value).max()), 1e-300)
        weight = biweight(residual, spread)
        normal = terms.T @ (weight[:, None] * terms)
        coefficients = np.linalg.pinv(normal) @ (terms.T @ (weight * value))
    return np.asarray(coefficients, np.float64), np.asarray(spread**2 * np.linalg.pinv(normal), np.float64)


def reflectance(rectified: Rectified, white: WhiteRadiance, albedo: float) -> Rectified:
    """Radiance over the irradiance of the sample plane: L / L_white * albedo / pi, in 1/sr.

    The white frame is Lambertian with `albedo`, so its radiance is albedo / pi times the irradiance, cosine included.
    """
    points = rectified.texels.centres_m
    level = white.radiance(points)
    scale = albedo / np.pi / level
    value = rectified.value * scale
    variance = rectified.variance * scale**2 + (value / level) ** 2 * white.variance(points)
    return replace(rectified, value=value.astype(np.float32), variance=variance.astype(np.float32))
