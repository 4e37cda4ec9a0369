"""Photometric stereo of every pixel by itself: robust start, then weighted least squares, in compiled loops.

A matt surface of scaled normal b shows b . e under a light of vector e, which points from the surface to the light and
is as long as its irradiance relative to the picture's middle. Shadows and highlights are not on that plane; what lies
on it is found by the plane through three samples that has the least median error, and then by Tukey's biweight.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from processing.materials.photometric_samples import FEWEST, NOISES, Array, Samples, Values, gather, lit
from processing.products import NormalStatus
from processing.robust import TUKEY
from processing.threads import in_parts

MEASURED, NO_SAMPLES, TOO_FEW, RANK_DEFICIENT, INCONSISTENT = (int(status) for status in NormalStatus)
LEAST_VOLUME = 1e-3  # of three light directions, for the plane through their samples
LEAST_SPREAD = 0.03  # least over largest singular value of the lights that count; noise grows by its inverse
ROUNDS = 30
SETTLED = 1e-8  # relative step at which the rounds end
_PART = 256  # pixels that a thread takes at a time


@njit(cache=True)
def normal_matrix(grey: Array, vector: Array, weights: Array) -> tuple[Array, Array]:
    """Sum of w e e^T (3, 3) and of w g e (3,)."""
    matrix, right = np.zeros((3, 3)), np.zeros(3)
    for i in range(len(weights)):
        for j in range(3):
            weighted = weights[i] * vector[i, j]
            right[j] += weighted * grey[i]
            for k in range(3):
                matrix[j, k] += weighted * vector[i, k]
    return matrix, right


@njit(cache=True)
def solve_scaled_normal(matrix: Array, right: Array) -> Array:
    """Solution of a symmetric 3 x 3 system by its adjugate; NaN where the matrix is singular."""
    a, b, c, d, e, f = matrix[0, 0], matrix[0, 1], matrix[0, 2], matrix[1, 1], matrix[1, 2], matrix[2, 2]
    aa, ab, ac = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * aa + b * ab + c * ac
    found = np.full(3, np.nan)
    if abs(determinant) > 1e-14 * abs(a * d * f):
        bb, bc, cc = a * f - c * c, b * c - a * e, a * d - b * b
        found[0] = (aa * right[0] + ab * right[1] + ac * right[2]) / determinant
        found[1] = (ab * right[0] + bb * right[1] + bc * right[2]) / determinant
        found[2] = (ac * right[0] + bc * right[1] + cc * right[2]) / determinant
    return found


@njit(cache=True)
def cross(p: Array, q: Array) -> tuple[float, float, float]:
    """p x q."""
    return p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]


@njit(cache=True)
def plane_through(vector: Array, grey: Array, triple: NDArray[np.intp]) -> tuple[float, float, float]:
    """The scaled normal that three samples have; NaN where their lights lie nearly in a plane."""
    i, j, k = triple
    p, q, r = vector[i], vector[j], vector[k]
    qr, rp, pq = cross(q, r), cross(r, p), cross(p, q)
    volume = p[0] * qr[0] + p[1] * qr[1] + p[2] * qr[2]
    lengths2 = squared_length(p) * squared_length(q) * squared_length(r)
    if volume * volume < LEAST_VOLUME * LEAST_VOLUME * lengths2:
        return np.nan, np.nan, np.nan
    f, g, h = grey[i] / volume, grey[j] / volume, grey[k] / volume
    x, y, z = f * qr[0] + g * rp[0] + h * pq[0], f * qr[1] + g * rp[1] + h * pq[1], f * qr[2] + g * rp[2] + h * pq[2]
    return x, y, z


@njit(cache=True)
def squared_length(b: Array) -> float:
    """b . b."""
    return float(b[0] * b[0] + b[1] * b[1] + b[2] * b[2])


@njit(cache=True)
def squared_errors(grey: Array, vector: Array, b: Array) -> Array:
    """(g - b . e)^2 of every sample."""
    squared = np.empty(len(grey))
    for i in range(len(grey)):
        error = grey[i] - (b[0] * vector[i, 0] + b[1] * vector[i, 1] + b[2] * vector[i, 2])
        squared[i] = error * error
    return squared


@njit(cache=True)
def beats(grey: Array, vector: Array, b: tuple[float, float, float], least: float) -> bool:
    """Whether the median squared error of a plane is less than another's."""
    allowed = len(grey) - (len(grey) + FEWEST) // 2
    for i in range(len(grey)):
        error = grey[i] - (b[0] * vector[i, 0] + b[1] * vector[i, 1] + b[2] * vector[i, 2])
        if not error * error < least:
            allowed -= 1
            if allowed < 0:
                return False
    return True


@njit(cache=True)
def least_median(grey: Array, vector: Array, triples: NDArray[np.intp]) -> tuple[Array, float]:
    """The plane through three samples whose median squared error over all is least, and that error (Rousseeuw 1984)."""
    middle = (len(grey) + FEWEST) // 2 - 1
    best, least = np.full(3, np.nan), np.inf
    for k in range(len(triples)):
        if triples[k, 0] < 0:
            break
        b = plane_through(vector, grey, triples[k])
        if beats(grey, vector, b, least):
            best = np.array(b)
            least = float(np.sort(squared_errors(grey, vector, best))[middle])
    return best, least


@njit(cache=True)
def bulk_variance(grey: Array, vector: Array, b: Array, bound: float) -> float:
    """Variance of the samples within a squared error, about the plane that fits these; right in the median of pixels.

    The factor is the median of chi-squared over its degrees of freedom (Wilson and Hilferty 1931).
    """
    near = squared_errors(grey, vector, b) <= bound
    matrix, right = normal_matrix(grey, vector, near.astype(np.float64))
    squared = squared_errors(grey, vector, solve_scaled_normal(matrix, right))
    freedom = max(int(np.count_nonzero(near)) - 3, 1)
    return float((squared * near).sum() / (freedom * (1 - 2 / (9 * freedom)) ** 3))


@njit(cache=True)
def start(samples: Samples, triples: NDArray[np.intp], found: Array) -> None:
    """Fill in `found` (4,) of one pixel, where there are samples enough."""
    use = lit(samples)
    if len(use) < FEWEST:
        return
    taken = min(len(use), len(triples) - 1)
    use = use[(np.arange(taken) * len(use)) // taken]
    grey, vector = samples.grey[use], samples.vector[use]
    b, least = least_median(grey, vector, triples[taken])
    # 1.4826 makes a median of normal errors a deviation; the rest is for few samples (Rousseeuw, Leroy 1987)
    bound = (2.5 * 1.4826 * (1 + 5 / max(taken - 3, 1))) ** 2 * least
    excess = bulk_variance(grey, vector, b, bound) - samples.variance[use].mean()
    found[:3], found[3] = b, excess / squared_length(b)


@njit(nogil=True, cache=True)
def _starts(
    value: Values, variance: Values, lights: Array, points: Array, triples: NDArray[np.intp], found: Array
) -> None:
    for pixel in range(len(points)):
        start(gather(value[:, pixel], variance[:, pixel], lights, points[pixel]), triples, found[pixel])


def starts(value: Values, variance: Values, lights: Array, points: Array, triples: NDArray[np.intp]) -> Array:
    """Scaled normal by least median and relative variance beyond the noise, (pixel, 4); NaN where there is none.

    `value` and `variance` are (light, pixel, 3), `lights` directions and distances (light, 4), `points` (pixel, 3).
    `triples` (m, k, 3) are the places to take of m samples, ended by -1; of more than m - 1 samples that many are
    taken, evenly.
    """
    found = np.full((len(points), 4), np.nan)

    def part(first: int, stop: int) -> None:
        some = slice(first, stop)
        _starts(value[:, some], variance[:, some], lights, points[some], triples, found[some])

    in_parts(part, len(points), _PART)
    return found


@njit(cache=True)
def weights_of(samples: Samples, b: Array, misfit: float) -> Array:
    """Weights (m,): the biweight over the variance of noise and misfit; 0 for shadows, attached and cast."""
    weights = np.zeros(len(samples.grey))
    excess = misfit * squared_length(b)
    for i in range(len(weights)):
        model = b[0] * samples.vector[i, 0] + b[1] * samples.vector[i, 1] + b[2] * samples.vector[i, 2]
        error, noise = samples.grey[i] - model, samples.variance[i]
        cast = samples.grey[i] < samples.dark and -error > NOISES * np.sqrt(noise)
        if model > 0 and not cast:
            sigma2 = noise + excess
            weights[i] = max(1 - error * error / (TUKEY * TUKEY * sigma2), 0.0) ** 2 / sigma2
    return weights


@njit(cache=True)
def refine(samples: Samples, b: Array, misfit: float) -> tuple[Array, Array]:
    """Reweighted least squares from a start; the scaled normal, NaN where nothing holds it, and its weights."""
    weights = weights_of(samples, b, misfit)
    for _ in range(ROUNDS):
        matrix, right = normal_matrix(samples.grey, samples.vector, weights)
        after = solve_scaled_normal(matrix, right)
        if not np.isfinite(after[0]):
            return after, weights
        step = np.abs(after - b).max()
        b = after
        weights = weights_of(samples, b, misfit)
        if step <= SETTLED * np.abs(b).max():
            break
    return b, weights


@njit(cache=True)
def angle_variance(samples: Samples, b: Array, weights: Array) -> float:
    """Mean squared angle of the normal's error: both tangential parts of b's covariance over its squared length.

    The covariance is the inverse normal matrix, enlarged where the errors exceed what was believed by more than chance.
    """
    matrix = normal_matrix(samples.grey, samples.vector, weights)[0]
    inverse = np.linalg.inv(matrix)
    freedom = max(int(np.count_nonzero(weights)) - 3, 1)
    excess = (weights * squared_errors(samples.grey, samples.vector, b)).sum() / freedom
    if excess < 1 + 3 * np.sqrt(2 / freedom):
        excess = 1.0
    length2 = squared_length(b)
    radial = (b * (inverse @ b)).sum() / length2
    return float((inverse[0, 0] + inverse[1, 1] + inverse[2, 2] - radial) / length2 * excess)


@njit(cache=True)
def judge(samples: Samples, begun: Array, b: Array, weights: Array) -> int:
    """What became of a pixel that has samples."""
    bright = len(lit(samples))
    if bright < FEWEST:
        return TOO_FEW
    if np.isnan(begun[0]):
        return RANK_DEFICIENT
    used = np.count_nonzero(weights)
    if used < FEWEST or 2 * used < bright or not b[2] > 0:
        return INCONSISTENT
    spread = np.linalg.eigvalsh(normal_matrix(samples.grey, samples.vector, weights)[0])
    return MEASURED if spread[0] > LEAST_SPREAD**2 * spread[2] else RANK_DEFICIENT


@njit(cache=True)
def albedo(value: Values, samples: Samples, b: Array, weights: Array) -> Array:
    """pi times the reflectance (3,) by which the samples that count show this normal, NaN where a channel has none."""
    shown, squared = np.zeros(3), np.zeros(3)
    length = np.sqrt(squared_length(b))
    for i in range(len(weights)):
        vector = samples.vector[i]
        model = (b[0] * vector[0] + b[1] * vector[1] + b[2] * vector[2]) / length
        for channel in range(3):
            f = value[samples.light[i], channel]
            if np.isfinite(f):
                shown[channel] += weights[i] * model * f
                squared[channel] += weights[i] * model * model
    found = np.full(3, np.nan)
    for channel in range(3):
        if squared[channel] > 0:
            found[channel] = np.pi * shown[channel] / squared[channel]
    return found


@njit(cache=True)
def measure(value: Values, samples: Samples, begun: Array, found: Array) -> int:
    """Status of one pixel; its `found` (7,) is filled in where that is MEASURED."""
    if len(samples.grey) == 0:
        return NO_SAMPLES
    b, weights = refine(samples, begun[:3], begun[3])
    status = judge(samples, begun, b, weights)
    if status == MEASURED:
        found[:3], found[3] = b, angle_variance(samples, b, weights)
        found[4:] = albedo(value, samples, b, weights)
    return status


@njit(nogil=True, cache=True)
def _normals(
    value: Values, variance: Values, lights: Array, points: Array, begun: Array, found: Array
) -> NDArray[np.uint8]:
    status = np.empty(len(points), np.uint8)
    for pixel in range(len(points)):
        samples = gather(value[:, pixel], variance[:, pixel], lights, points[pixel])
        status[pixel] = measure(value[:, pixel], samples, begun[pixel], found[pixel])
    return status


def normals(
    value: Values, variance: Values, lights: Array, points: Array, begun: Array
) -> tuple[Array, NDArray[np.uint8]]:
    """Scaled normal, its mean squared angle and the albedo (pixel, 7), NaN where there is none, and status (pixel,).

    `begun` (pixel, 4) is what `starts` gave, its last the relative variance that is allowed beyond the noise.
    """
    found, status = np.full((len(points), 7), np.nan), np.empty(len(points), np.uint8)

    def part(first: int, stop: int) -> None:
        some = slice(first, stop)
        status[some] = _normals(value[:, some], variance[:, some], lights, points[some], begun[some], found[some])

    in_parts(part, len(points), _PART)
    return found, status
