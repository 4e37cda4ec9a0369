"""The laser's plane at any moment of a sweep, from the stripe on the sample holder's stepped white frame.

The holder shows two known heights in every frame. Each of its pixels therefore has a known 3D point and, by space-time
analysis, the moment at which the plane held that point. One model explains all of them: planes through one line (the
fan's axis through the laser) whose angle is a smooth function of time. That is the paper's angle from two heights
(Wang et al. 2005, section 3.2) with every frame of the sweep instead of two, and a plane for any real time.
"""

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from processing.cameras.calibration import CameraModel
from processing.laser.fan import Fan, fan_angle, fan_gradient, fan_source
from processing.laser.holder import Holder, reference_region
from processing.laser.space_time import PeakStatus, PeakTimes
from processing.robust import biweight, bulk_deviation

Array = NDArray[np.float64]
_KNOT_FRAMES = 2.0  # follows a ripple of eight frames' period to a fiftieth of its amplitude
_UNEVENNESS = 0.1  # relative change of the motor's speed from knot to knot (one sigma)
_MIN_POINTS = 60
_MAX_POINTS = 12000
_ITERATIONS = 30
_SLOWEST = 0.3  # of the mean speed: where the spline is slower, it follows noise
_LATEST_FRAMES = 0.5  # by which a time is corrected; what is later is an outlier
_STEP_M = 1e-4  # in height that tells the holder's two levels apart
_SECOND_HEIGHT = 0.02  # share of the points that must lie on the lower one
_CHUNK = 32768


class SweepStatus(IntEnum):
    """Outcome of a sweep's fit; NO_STRIPE carries no planes."""

    OK = 0
    ONE_HEIGHT = 1  # only one height saw the stripe: the laser's place is as good as its nominal numbers
    NO_STRIPE = 2  # too few reference pixels saw the stripe, or it did not move


@dataclass(frozen=True, slots=True)
class LaserMount:
    """Where the laser unit should be, rig frame, with one-sigma tolerances of the mounting by hand."""

    azimuth_rad: float
    elevation_rad: float
    distance_m: float
    elevation_tolerance_rad: float = 0.025
    distance_tolerance_m: float = 0.020
    azimuth_tolerance_rad: float = 0.015
    roll_tolerance_rad: float = 0.015

    @property
    def fan(self) -> Fan:
        """Nominal parameters."""
        return np.array([self.elevation_rad, self.distance_m, self.azimuth_rad, 0.0])

    @property
    def weights(self) -> Array:
        """Inverse variances of the parameters before anything is measured."""
        sigma = (
            self.elevation_tolerance_rad,
            self.distance_tolerance_m,
            self.azimuth_tolerance_rad,
            self.roll_tolerance_rad,
        )
        return np.asarray(np.array(sigma) ** -2.0)


@dataclass(frozen=True)
class LaserSweep:
    """Laser planes of one sweep, rig frame.

    `fan` are the laser's elevation, distance, azimuth and the roll of the fan's axis; `spline` gives the plane's
    depression angle in radians over time in frames, known from `first` to `last`. `covariance` is that of the four
    parameters and the spline's coefficients together. `excess_rad` is the scatter of the reference points that the
    noise of their times does not explain (camera calibration, holder). `outliers` of `points` had no say.
    """

    status: SweepStatus
    fan: Fan
    spline: BSpline = field(repr=False)
    covariance: Array = field(repr=False)
    first: float
    last: float
    excess_rad: float
    points: int
    outliers: int

    @property
    def source_m(self) -> Array:
        """Position (3,) of the laser."""
        return fan_source(self.fan)[0]

    @property
    def deviation(self) -> Array:
        """One-sigma uncertainties (4,) of `fan`."""
        return np.asarray(np.sqrt(np.diag(self.covariance)[:4]))

    def planes(self, time_frames: NDArray[np.floating]) -> tuple[Array, Array]:
        """Unit normals (..., 3) and offsets (...) of the planes n . p = d at these times; NaN outside the sweep."""
        source, level, up = fan_source(self.fan)
        with np.errstate(invalid="ignore"):
            inside = (time_frames >= self.first) & (time_frames <= self.last)
        angle = np.where(inside, self.spline(np.where(inside, time_frames, self.first)), np.nan)[..., None]
        normal = np.sin(angle) * level - np.cos(angle) * up
        return normal, normal @ source

    def angle_variance(self, points_m: Array, time_frames: Array, time_variance: Array) -> Array:
        """Variance (n,) in rad^2 of the angle between the plane at a time and the point (n, 3) measured by it.

        The time's own variance, the model's uncertainty there, and the unexplained scatter.
        """
        variance = self.spline.derivative()(time_frames) ** 2 * time_variance + self.excess_rad**2
        for start in range(0, len(points_m), _CHUNK):
            part = slice(start, start + _CHUNK)
            basis = _basis(self.spline.t, time_frames[part])
            jacobian = np.hstack([fan_gradient(self.fan, points_m[part]), -basis])
            variance[part] += np.einsum("ij,ij->i", jacobian @ self.covariance, jacobian)
        return np.asarray(variance, np.float64)


def sweep_planes(
    peaks: PeakTimes, camera: CameraModel, rig_from_sample: Array, holder: Holder, mount: LaserMount
) -> LaserSweep:
    """Laser planes of a sweep from the peak times of one camera that sees the holder.

    Never raises because of what the frames show: see `LaserSweep.status`.
    """
    region = reference_region(camera, rig_from_sample, holder, fan_source(mount.fan)[0])
    chosen = np.flatnonzero((region.height > 0) & (peaks.status == PeakStatus.OK))
    chosen = chosen[:: max(-(-chosen.size // _MAX_POINTS), 1)]
    time, variance = (values.ravel()[chosen].astype(np.float64) for values in (peaks.time_frames, peaks.variance))
    return fit_sweep(region.points_m.reshape(-1, 3)[chosen], time, variance, mount)


def fit_sweep(points_m: Array, time_frames: Array, time_variance: Array, mount: LaserMount) -> LaserSweep:
    """Laser planes from rig-frame points (n, 3) and the times (n,) with variances (n,) at which the plane held them.

    Robust least squares of every point's angle about the fan's axis against a cubic spline of its time: iteratively
    reweighted (Tukey) from a median line, with the mount's tolerances and the motor's evenness as priors.
    """
    if len(points_m) < _MIN_POINTS:
        return _no_stripe(mount, len(points_m))
    first, last = np.percentile(time_frames, [0.5, 99.5])
    inside = (time_frames >= first) & (time_frames <= last)
    problem = _Problem(points_m[inside], time_frames[inside], time_variance[inside], mount, _knots(first, last))
    if last - first < 4 * _KNOT_FRAMES or problem.rate == 0.0:
        return _no_stripe(mount, len(points_m))
    solution, covariance, weights = problem.solve()
    used = problem.points_m[weights > 0.0]
    one_height = float(np.mean(used[:, 2] < used[:, 2].max() - _STEP_M)) < _SECOND_HEIGHT
    return LaserSweep(
        SweepStatus.ONE_HEIGHT if one_height else SweepStatus.OK,
        solution[:4],
        BSpline(problem.knots, solution[4:], 3),
        covariance,
        float(first),
        float(last),
        problem.excess,
        len(weights),
        int(np.count_nonzero(weights < 0.1)),
    )


def _no_stripe(mount: LaserMount, points: int) -> LaserSweep:
    unknown = np.full((8, 8), np.nan)
    spline = BSpline(_knots(0.0, 1.0), np.zeros(4), 3)
    return LaserSweep(SweepStatus.NO_STRIPE, mount.fan, spline, unknown, np.inf, -np.inf, np.nan, points, points)


class _Problem:
    """The reweighted least squares of one sweep: four parameters of the fan, then the spline's coefficients."""

    def __init__(self, points_m: Array, time: Array, variance: Array, mount: LaserMount, knots: Array) -> None:
        self.points_m, self.time, self.variance, self.mount, self.knots = points_m, time, variance, mount, knots
        self.rate, start = _median_line(time, fan_angle(mount.fan, points_m))
        self.excess = bulk_deviation(fan_angle(mount.fan, points_m) - start - self.rate * time)
        self.start = np.concatenate([mount.fan, start + self.rate * _greville(knots)])
        self.prior = self._prior()

    def solve(self) -> tuple[Array, Array, Array]:
        """Solution, covariance, and the final robust weights of the points."""
        solution = self.start
        for iteration in range(_ITERATIONS):
            spline = BSpline(self.knots, solution[4:], 3)
            speed = spline.derivative()(self.time)
            residual = fan_angle(solution[:4], self.points_m) - spline(self.time)
            sigma = self._sigma(residual, speed)
            weights = biweight(residual, sigma)
            jacobian = self._jacobian(solution, residual, speed)
            covariance, step = self._step(solution, residual / sigma, jacobian / sigma[:, None], weights)
            solution = solution + step
            if iteration > 5 and np.abs(jacobian @ step).max() < 1e-2 * np.median(sigma):
                break
        return solution, covariance, weights

    def _sigma(self, residual: Array, speed: Array) -> Array:
        """Standard deviation of every residual; brings `excess` to where the robust scale of residual / sigma is 1."""
        noise = np.maximum(speed**2, (_SLOWEST * self.rate) ** 2) * self.variance
        for _ in range(8):
            sigma2 = noise + self.excess**2
            change = (bulk_deviation(residual / np.sqrt(sigma2)) ** 2 - 1.0) * float(np.median(sigma2))
            self.excess = float(np.sqrt(max(self.excess**2 + change, 1e-4 * np.median(noise))))
        return np.asarray(np.sqrt(noise + self.excess**2))

    def _jacobian(self, solution: Array, residual: Array, speed: Array) -> Array:
        """Derivatives of the residuals at the times that the model gives to the points, not at the measured ones.

        The times carry the noise, the points do not: with the noise among the regressors the laser would seem too far.
        """
        late = residual / np.where(np.abs(speed) > _SLOWEST * abs(self.rate), speed, self.rate)
        basis = _basis(self.knots, self.time + np.clip(late, -_LATEST_FRAMES, _LATEST_FRAMES))
        return np.hstack([fan_gradient(solution[:4], self.points_m), -basis])

    def _step(self, solution: Array, residual: Array, jacobian: Array, weights: Array) -> tuple[Array, Array]:
        normal = (jacobian * weights[:, None]).T @ jacobian + self.prior
        pull = jacobian.T @ (weights * residual) + self.prior @ (solution - self.start)
        covariance = np.asarray(np.linalg.inv(normal), np.float64)
        return covariance, -covariance @ pull

    def _prior(self) -> Array:
        """Inverse covariance of the deviation from the start: the mount's tolerances, the motor's evenness."""
        count = len(self.knots) - 4
        second = np.diff(np.eye(count), n=2, axis=0) / (_UNEVENNESS * abs(self.rate) * _KNOT_FRAMES + 1e-12)
        prior = np.zeros((4 + count, 4 + count))
        prior[:4, :4] = np.diag(self.mount.weights)
        prior[4:, 4:] = second.T @ second
        return prior


def _knots(first: float, last: float) -> Array:
    pieces = max(int(np.ceil((last - first) / _KNOT_FRAMES)), 1)
    return np.concatenate([[first] * 3, np.linspace(first, last, pieces + 1), [last] * 3])


def _greville(knots: Array) -> Array:
    """The times at which coefficients on a straight line make the spline that line."""
    return np.asarray((knots[1:-3] + knots[2:-2] + knots[3:-1]) / 3.0)


def _basis(knots: Array, time: Array) -> Array:
    return np.asarray(BSpline.design_matrix(np.clip(time, knots[0], knots[-1]), knots, 3).toarray())


def _median_line(time: Array, angle: Array) -> tuple[float, float]:
    """Slope and intercept of a line through the bulk (Theil-Sen on pairs half the data apart in time)."""
    order = np.argsort(time, kind="stable")
    half = len(order) // 2
    early, late = order[:half], order[-half:]
    apart = time[late] - time[early]
    slope = float(np.median((angle[late] - angle[early])[apart > 0] / apart[apart > 0])) if np.any(apart > 0) else 0.0
    return slope, float(np.median(angle - slope * time))
