"""The laser's plane at any moment of a sweep, from the stripe on the sample holder's stepped white frame.

The holder shows two known heights in every frame. Each of its pixels therefore has a known 3D point and, by space-time
analysis, the moment at which the plane held that point. One model explains all of them: planes through one line (the
fan's axis through the laser) whose angle is a smooth function of time. That is the paper's angle from two heights
(Wang et al. 2005, section 3.2) with every frame of the sweep instead of two, and a plane for any real time.
"""

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from processing.cameras.calibration import CameraModel
from processing.laser import sweep_kernel
from processing.laser.even_spline import abscissae, even_knots, pieces_at, spline_on
from processing.laser.fan import Fan, fan_angle, fan_frame, fan_source
from processing.laser.holder import Holder, reference_region
from processing.laser.range_kernel import SweepModel
from processing.laser.space_time import PeakStatus, PeakTimes
from processing.robust import biweight, bulk_deviation

Array = NDArray[np.float64]
_KNOT_FRAMES = 1.0
_MOST_PIECES = 400  # a longer sweep is known to a four hundredth of it: the work grows with the cube
_UNEVENNESS = 0.1  # relative change of the motor's speed from knot to knot (one sigma), before the sweep tells its own
_EVENEST = 1e-4
_INLIER_SQUARE = 0.828  # mean square of normal errors under the weights of the biweight
_MIN_POINTS = 60
_MAX_POINTS = 12000
_ITERATIONS = 30
_SLOWEST = 0.3  # of the mean speed: where the spline is slower, it follows noise
_LATEST_FRAMES = 0.5  # by which a time is corrected; what is later is an outlier
_STEP_M = 1e-4  # in height that tells the holder's two levels apart
_SHORTEST_FRAMES = 8.0  # of a sweep whose motion can be told
_SECOND_HEIGHT = 0.02  # share of the points that must lie on the lower one
_PRECISE = 4.0  # times the variance of a piece's most precise tenth: the colour that the laser has
_FEWEST = 5  # of them that can tell a piece's own scatter
_BEYOND_DOUBT = 4.0  # standard errors of that scatter


class SweepStatus(IntEnum):
    """Outcome of a sweep's fit; NO_STRIPE carries no planes."""

    OK = 0
    ONE_HEIGHT = 1  # only one height saw the stripe: the laser's place is as good as its nominal numbers
    NO_STRIPE = 2  # too few reference pixels saw the stripe, or it did not move as one plane


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
    noise of their times does not explain (camera calibration, holder); `local_excess_rad` (pieces of the spline) is
    more than that where frames around a time were lost, doubled or late. `outliers` of `points` had no say.
    """

    status: SweepStatus
    fan: Fan
    spline: BSpline = field(repr=False)
    covariance: Array = field(repr=False)
    first: float
    last: float
    excess_rad: float
    local_excess_rad: Array = field(repr=False)
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

    @property
    def model(self) -> SweepModel:
        """The planes and their uncertainty as the kernels take them."""
        spline = (self.spline.t, self.spline.c)
        excess_rad2 = self.local_excess_rad**2
        return SweepModel(fan_frame(self.fan), *spline, self.covariance, excess_rad2, self.first, self.last)

    def planes(self, time_frames: NDArray[np.floating]) -> tuple[Array, Array]:
        """Unit normals (..., 3) and offsets (...) of the planes n . p = d at these times; NaN outside the sweep."""
        source, level, up = fan_source(self.fan)
        with np.errstate(invalid="ignore"):
            inside = (time_frames >= self.first) & (time_frames <= self.last)
        angle = np.where(inside, self.spline(np.where(inside, time_frames, self.first)), np.nan)[..., None]
        normal = np.sin(angle) * level - np.cos(angle) * up
        return normal, normal @ source


def sweep_planes(
    peaks: PeakTimes, camera: CameraModel, rig_from_sample: Array, holder: Holder, mount: LaserMount
) -> LaserSweep:
    """Laser planes of a sweep from the peak times of one camera that sees the holder.

    Never raises because of what the frames show: see `LaserSweep.status`.
    """
    region = reference_region(camera, rig_from_sample, holder, fan_source(mount.fan)[0])
    chosen = np.flatnonzero((region.height > 0) & (peaks.status == PeakStatus.OK))
    stride = max(-(-chosen.size // _MAX_POINTS), 1)
    chosen = chosen[:: stride + 1 - stride % 2]  # an odd step meets all colours of the mosaic
    time, variance = (values.ravel()[chosen].astype(np.float64) for values in (peaks.time_frames, peaks.variance))
    return fit_sweep(region.points_m.reshape(-1, 3)[chosen], time, variance, mount)


def fit_sweep(points_m: Array, time_frames: Array, time_variance: Array, mount: LaserMount) -> LaserSweep:
    """Laser planes from rig-frame points (n, 3) and the times (n,) with variances (n,) at which the plane held them.

    Robust least squares of every point's angle about the fan's axis against a cubic spline of its time: iteratively
    reweighted (Tukey) from a median line, with the mount's tolerances as priors and a spline as smooth as the sweep
    itself tells. Points that are not finite have no say.
    """
    values = np.column_stack([points_m, time_frames, time_variance]).astype(np.float64)
    values = values[np.isfinite(values).all(axis=1) & (values[:, 4] > 0.0)]
    points_m, time_frames, time_variance = values[:, :3].copy(), values[:, 3].copy(), values[:, 4].copy()
    if len(points_m) < _MIN_POINTS:
        return _no_stripe(mount, len(points_m))
    first, last = np.percentile(time_frames, [0.5, 99.5])
    inside = (time_frames >= first) & (time_frames <= last)
    if last - first < _SHORTEST_FRAMES:
        return _no_stripe(mount, len(points_m))
    problem = _Problem(points_m[inside], time_frames[inside], time_variance[inside], mount, _knots(first, last))
    if problem.rate == 0.0:
        return _no_stripe(mount, len(points_m))
    solution, covariance, weights = problem.solve()
    used = problem.points_m[weights > 0.0]
    if len(used) < _MIN_POINTS or not (np.isfinite(covariance).all() and (np.diagonal(covariance) > 0.0).all()):
        return _no_stripe(mount, len(points_m))
    one_height = float(np.mean(used[:, 2] < used[:, 2].max() - _STEP_M)) < _SECOND_HEIGHT
    return LaserSweep(
        SweepStatus.ONE_HEIGHT if one_height else SweepStatus.OK,
        solution[:4],
        spline_on(problem.knots, solution[4:]),
        covariance,
        float(first),
        float(last),
        problem.excess,
        problem.local_excess(solution),
        len(weights),
        int(np.count_nonzero(weights < 0.1)),
    )


def _no_stripe(mount: LaserMount, points: int) -> LaserSweep:
    unknown = np.full((8, 8), np.nan)
    spline = spline_on(even_knots(0.0, 1.0, 1), np.zeros(4))
    nan = np.full(1, np.nan)
    return LaserSweep(SweepStatus.NO_STRIPE, mount.fan, spline, unknown, np.inf, -np.inf, np.nan, nan, points, points)


class _Problem:
    """The reweighted least squares of one sweep: four parameters of the fan, then the spline's coefficients."""

    def __init__(self, points_m: Array, time: Array, variance: Array, mount: LaserMount, knots: Array) -> None:
        self.points_m, self.time, self.variance, self.mount, self.knots = points_m, time, variance, mount, knots
        self.rate, start = _median_line(time, fan_angle(mount.fan, points_m))
        self.excess = bulk_deviation(fan_angle(mount.fan, points_m) - start - self.rate * time)
        self.start = np.concatenate([mount.fan, start + self.rate * abscissae(knots)])
        self.unevenness = _UNEVENNESS
        second = np.diff(np.eye(len(abscissae(knots))), n=2, axis=0)
        self.bend = np.einsum("ki,kj->ij", second, second)

    def solve(self) -> tuple[Array, Array, Array]:
        """Solution, covariance, and the final robust weights of the points; nonsense has no covariance."""
        solution, before = self.start, np.full(len(self.time), np.inf)
        for iteration in range(_ITERATIONS):
            residual, speed = self._residuals(solution)
            sigma = self._sigma(residual, speed)
            weights = biweight(residual, sigma)
            covariance, step = self._step(solution, (residual, weights / sigma**2), speed)
            if not np.isfinite(step).all():
                break
            if iteration > 5 and np.abs(residual - before).max() < 1e-2 * np.median(sigma):
                break
            solution, before = solution + step, residual
            self._learn_unevenness(solution, covariance)
        return solution, covariance, weights

    def local_excess(self, solution: Array) -> Array:
        """`excess` in every piece of the spline, or what its or its neighbours' precise points scatter by, if larger.

        A frame that was lost, doubled or late makes the times around it wrong, for the sample as for the holder.
        """
        residual, speed = self._residuals(solution)
        noise = self._noise(speed)
        ratio = residual / np.sqrt(noise + self.excess**2)
        piece = pieces_at(self.knots, self.time)
        order = np.argsort(piece, kind="stable")
        local = np.full(len(self.knots) - 7, self.excess)
        for k, part in enumerate(np.split(order, np.searchsorted(piece[order], np.arange(1, len(local))))):
            if part.size < _FEWEST:
                continue
            precise = part[noise[part] <= _PRECISE * np.quantile(noise[part], 0.1)]
            scatter = bulk_deviation(ratio[precise])
            if precise.size >= _FEWEST and scatter > 1.0 + _BEYOND_DOUBT / np.sqrt(precise.size):
                local[k] = np.hypot(scatter * self.excess, np.sqrt((scatter**2 - 1.0) * np.median(noise[precise])))
        return np.asarray(sliding_window_view(np.pad(local, 1, mode="edge"), 3).max(axis=1))

    def _residuals(self, solution: Array) -> Array:
        """Angles (2, n): every point's less the plane's at its time, and the plane's speed then."""
        found = np.empty((2, len(self.time)))
        sweep_kernel.residuals(self.points_m, self.time, fan_frame(solution[:4]), (self.knots, solution[4:]), found)
        return found

    def _sigma(self, residual: Array, speed: Array) -> Array:
        """Standard deviation of every residual; `excess` becomes what makes their squares as large as expected.

        By maximum likelihood, so that precise points tell it, under Tukey's weights, so that wrong ones do not.
        """
        noise = self._noise(speed)
        for _ in range(4):
            sigma2 = noise + self.excess**2
            weights = biweight(residual, np.sqrt(sigma2)) / sigma2**2
            surplus = float(np.sum(weights * (residual**2 / _INLIER_SQUARE - sigma2)) / max(weights.sum(), 1e-300))
            self.excess = float(np.sqrt(max(self.excess**2 + surplus, 1e-4 * np.median(noise))))
        return np.asarray(np.sqrt(noise + self.excess**2))

    def _noise(self, speed: Array) -> Array:
        """Variance of the points' angles that their times explain."""
        return np.asarray(np.maximum(speed**2, (_SLOWEST * self.rate) ** 2) * self.variance, np.float64)

    def _step(self, solution: Array, errors: tuple[Array, Array], speed: Array) -> tuple[Array, Array]:
        """Covariance of the solution, and the way to the next one.

        The derivatives are those at the times that the model gives to the points, not at the measured ones. The times
        carry the noise, the points do not: with the noise among the regressors the laser would seem too far.
        """
        late = errors[0] / np.where(np.abs(speed) > _SLOWEST * abs(self.rate), speed, self.rate)
        time = self.time + np.clip(late, -_LATEST_FRAMES, _LATEST_FRAMES)
        normal = self._prior()
        pull = normal @ (solution - self.start)
        sweep_kernel.normal_equations(self.points_m, time, errors, fan_frame(solution[:4]), self.knots, (normal, pull))
        sweep_kernel.invert(normal)
        return normal, -np.einsum("ij,j->i", normal, pull)

    def _prior(self) -> Array:
        """Inverse covariance of the deviation from the start: the mount's tolerances, the motor's evenness."""
        prior = np.diag(np.concatenate([self.mount.weights, np.zeros(len(self.start) - 4)]))
        prior[4:, 4:] = self.bend / (self.unevenness * self._advance) ** 2
        return prior

    def _learn_unevenness(self, solution: Array, covariance: Array) -> None:
        """Let the changes of speed be as large as those found: their evidence's maximum (MacKay 1992, section 4)."""
        change = np.diff(solution[4:], n=2) / self._advance
        own, next_, after = (np.diagonal(covariance[4:, 4:], offset) for offset in range(3))
        spread = own[:-2] + 4 * own[1:-1] + own[2:] - 4 * (next_[:-1] + next_[1:]) + 2 * after
        determined = max(len(change) - float(spread.sum()) / (self.unevenness * self._advance) ** 2, 1.0)
        self.unevenness = max(float(np.sqrt(change @ change / determined)), _EVENEST)

    @property
    def _advance(self) -> float:
        """Angle from knot to knot at the mean speed."""
        return abs(self.rate) * float(self.knots[1] - self.knots[0])


def _knots(first: float, last: float) -> Array:
    pieces = int(np.ceil((last - first) / _KNOT_FRAMES))
    return even_knots(first, last, min(max(pieces, 1), _MOST_PIECES))


def _median_line(time: Array, angle: Array) -> tuple[float, float]:
    """Slope and intercept of a line through the bulk (Theil-Sen on pairs half the data apart in time)."""
    order = np.argsort(time, kind="stable")
    half = len(order) // 2
    early, late = order[:half], order[-half:]
    apart = time[late] - time[early]
    slope = float(np.median((angle[late] - angle[early])[apart > 0] / apart[apart > 0])) if np.any(apart > 0) else 0.0
    return slope, float(np.median(angle - slope * time))
