"""Intensity, falloff and distance of lamps from how their light spreads over a matt white plate.

A point lamp at p gives the plane z = 0 the irradiance I p_z / |p - x|^(n + 1): its cosine over its distance to the
power of n = 2. A camera sees it through its own vignetting and its pixels' own response, which no lamp and no angle
changes: these have a free factor in each cell of the plate, and what differs between lamps and angles tells where they
stand.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing import geometry
from processing.cameras.calibration import CameraModel
from processing.errors import CalibrationError, ImageError
from processing.lamps.model import INVERSE_SQUARE, LampPlaces
from processing.radiometry.hdr import Radiance
from processing.radiometry.mosaic import cfa_channels
from processing.robust import biweight, bulk_deviation

Array = NDArray[np.float64]
CELLS = 16  # along each side of the plate
VIGNETTE_SIGMA = 0.03  # of a camera's factor in a cell, relative
SENSITIVITY_SIGMA = 0.1  # of a camera's sensitivity against the others'
MEAN_SENSITIVITY_SIGMA = 1e-3
FALLOFF_SIGMA = 1.0
_LEAST_PIXELS = 2  # of a channel in a cell
_LEAST_CELLS = 40  # of a channel in a view, for its shape to mean something
_LEAST_NOISES = 10.0  # mean of a cell over its deviation
_LEAST_SPREAD = 0.01  # of the first residuals of a view, relative
_LEAST_SINE = 0.05  # of a lamp's elevation: grazing light is mostly what it was reflected by before
_ROUNDS = 4


@dataclass(frozen=True, eq=False)
class PlateView:
    """Mean radiance of the plate's cells under one lamp, its carrier at an angle, in one camera.

    `log_value` (cells, 3) is its logarithm, `information` the inverse of that one's variance, 0 where a cell is not
    wholly measured or does not rise over its noise. `points_m` (cells, 3, 3) is the mean place of each channel's
    pixels in the rig frame.
    """

    lamp: str
    camera: str
    angle_rad: float
    log_value: Array
    information: Array
    points_m: Array

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Channels (3,) in which anything is measured."""
        return np.asarray((self.information > 0).any(axis=0), np.bool_)


@dataclass(frozen=True, eq=False)
class PlateCells:
    """The square of the plate in one camera's mosaic: `pixels` (h, w) of it, the cell and channel of each of them."""

    pixels: NDArray[np.bool_]
    place: NDArray[np.int64]
    count: Array
    points_m: Array

    @classmethod
    def of(cls, camera: CameraModel, cfa: NDArray[np.uint8], side_m: float) -> "PlateCells":
        """Cells of the square of this side about the rig's origin, in the plane z = 0."""
        points = geometry.intersect_plane(camera.centre_m, camera.pixel_rays(), (0.0, 0.0, 1.0), 0.0)
        column, row = (np.floor((points[..., k] / side_m + 0.5) * CELLS) for k in (0, 1))
        with np.errstate(invalid="ignore"):
            inside = (column >= 0) & (column < CELLS) & (row >= 0) & (row < CELLS)
        cell = (row[inside] * CELLS + column[inside]).astype(np.int64)
        place = 3 * cell + cfa_channels(cfa, camera.size)[inside].astype(np.int64)
        count = np.bincount(place, minlength=3 * CELLS**2).astype(np.float64)
        sums = [np.bincount(place, points[inside][:, k], minlength=3 * CELLS**2) for k in range(3)]
        mean = np.stack(sums, axis=-1) / np.maximum(count, 1)[:, None]
        return cls(inside, place, count.reshape(-1, 3), mean.reshape(-1, 3, 3))

    def view(self, radiance: Radiance, lamp: str, camera: str, angle_rad: float) -> PlateView:
        """Cell means of a merged mosaic. A missing or saturated pixel spoils its cell: the others would be biased.

        Raises ImageError where the mosaic is not this camera's.
        """
        if radiance.value.shape != self.pixels.shape:
            raise ImageError(f"{camera}: an image of shape {radiance.value.shape}, not of {self.pixels.shape}.")
        value, variance = (
            np.bincount(self.place, part[self.pixels].astype(np.float64), minlength=self.count.size).reshape(-1, 3)
            for part in (radiance.value, radiance.variance)
        )
        with np.errstate(invalid="ignore", divide="ignore"):
            clear = (self.count >= _LEAST_PIXELS) & np.isfinite(variance) & (value > _LEAST_NOISES * np.sqrt(variance))
            clear &= np.count_nonzero(clear, axis=0) >= _LEAST_CELLS
            information = np.where(clear & (variance > 0), value**2 / variance, 0.0)
        log_value = np.log(np.where(information > 0, value / np.maximum(self.count, 1), 1.0))
        return PlateView(lamp, camera, angle_rad, log_value, information, self.points_m)


@dataclass(frozen=True, eq=False)
class WhiteFit:
    """Lamps' places after the white plate, and their intensities in e-/s of a perfect diffuser at 1 m.

    `log_intensity` (n, 3) and its variance (n, 3), NaN where a lamp was not seen. `falloff` is the exponent that the
    plate itself tells, the same for all lamps, with its deviation; `held` is the one that the places were found with.
    `residual` is the relative root mean square.
    """

    places: LampPlaces
    log_intensity: Array
    log_variance: Array
    falloff: float
    falloff_deviation: float
    held: float
    residual: float


def fit_plate(views: Sequence[PlateView], known: LampPlaces, reflectance: float) -> WhiteFit:
    """Places by all views together with what is known of them, weighed by inverse covariance.

    The exponent of the falloff is first left free and told; places and intensities are then those of the inverse
    square where this is within three deviations of it, of the told exponent else. Cells that do not follow (shadows,
    dust, hot pixels) take no part (Tukey's biweight), nor do views whose lamp stands level with the plate or below it.
    Raises CalibrationError where no view shows the plate lit, or no places explain the views.
    """
    heights = known.positions_m[:, 2] / np.linalg.norm(known.positions_m, axis=1)
    above = {name for name, height in zip(known.names, heights, strict=True) if height > _LEAST_SINE}
    lit = [view for view in views if view.seen.any() and view.lamp in above]
    if not lit:
        raise CalibrationError(
            "the white plate is dark in every picture; check its place, the lamps and the exposures."
        )
    problem = _Problem(lit, known, np.log(reflectance))
    free = problem.solve(problem.start(), None)
    falloff, deviation = free.falloff
    held = INVERSE_SQUARE if abs(falloff - INVERSE_SQUARE) <= 3 * deviation else falloff
    solution = problem.solve(free.state, held)
    if not np.isfinite(solution.state).all():
        raise CalibrationError("no places of the lamps explain the white plate; check their labels in rig.toml.")
    return problem.describe(solution, (falloff, deviation))


@dataclass(frozen=True, eq=False)
class _Solution:
    """Unknowns, their covariance, and the residuals (cells, 3) with weights of every view."""

    state: Array
    covariance: Array
    residuals: list[Array]
    weights: list[Array]

    @property
    def falloff(self) -> tuple[float, float]:
        return float(self.state[0]), float(np.sqrt(self.covariance[0, 0]))


@dataclass(frozen=True)
class _Problem:
    """The unknowns are one vector: falloff, places and log intensities (3 a lamp each), sensitivities (3 a camera)."""

    views: Sequence[PlateView]
    known: LampPlaces
    log_reflectance: float

    @property
    def cameras(self) -> list[str]:
        return sorted({view.camera for view in self.views})

    def _columns(self, view: PlateView) -> NDArray[np.intp]:
        """Which unknowns (10,) a view depends on: falloff, its lamp's place and intensities, its camera's."""
        lamp, lamps = self.known.names.index(view.lamp), len(self.known.names)
        camera = self.cameras.index(view.camera)
        starts = (1 + 3 * lamp, 1 + 3 * lamps + 3 * lamp, 1 + 6 * lamps + 3 * camera)
        return np.concatenate([[0], *(start + np.arange(3) for start in starts)]).astype(np.intp)

    def start(self) -> Array:
        """Known places, falloff 2, intensities by the first look at each lamp."""
        lamps = len(self.known.names)
        state = np.zeros(1 + 6 * lamps + 3 * len(self.cameras))
        state[0] = INVERSE_SQUARE
        state[1 : 1 + 3 * lamps] = self.known.positions_m.ravel()
        for view in self.views:
            light = self._columns(view)[4:7]
            left = np.where(view.information > 0, view.log_value - self._model(state, view), np.nan)
            state[light] = np.where(view.seen & (state[light] == 0), _median(left), state[light])
        return state

    def _way(self, state: Array, view: PlateView) -> Array:
        """From each cell to the lamp (cells, 3, 3), rig frame."""
        place = self._columns(view)[1:4]
        return np.asarray(geometry.rotate(geometry.rotation_z(view.angle_rad), state[place]) - view.points_m)

    def _model(self, state: Array, view: PlateView) -> Array:
        """Logarithm (cells, 3) of what the camera sees; a lamp under the plate's horizon gives NaN."""
        columns, way = self._columns(view), self._way(state, view)
        with np.errstate(invalid="ignore", divide="ignore"):
            falling = np.log(way[..., 2]) - (state[0] + 1) / 2 * np.log(np.sum(way**2, axis=-1))
        return np.asarray(falling + state[columns[4:7]] + state[columns[7:]] + self.log_reflectance, np.float64)

    def _slopes(self, state: Array, view: PlateView) -> Array:
        """Slopes (cells, 3, 10) of `_model` with the view's own unknowns."""
        way = self._way(state, view)
        square = np.sum(way**2, axis=-1, keepdims=True)
        by_way = np.array([0.0, 0.0, 1.0]) / way[..., 2:] - (state[0] + 1) * way / square
        slopes = np.zeros((*way.shape[:2], 10))
        slopes[..., 0] = -0.5 * np.log(square[..., 0])
        slopes[..., 1:4] = by_way @ geometry.rotation_z(view.angle_rad)[:3, :3]
        for c in range(3):
            slopes[:, c, 4 + c] = slopes[:, c, 7 + c] = 1.0
        return slopes

    def solve(self, state: Array, held: float | None) -> _Solution:
        """Gauss-Newton with weights from the round before; `held` is a falloff that is not to move."""
        if held is not None:
            state = np.concatenate([[held], state[1:]])
        weights = [self._first_weight(state, view) for view in self.views]
        for _ in range(_ROUNDS):
            normal, gradient = self._system(state, weights)
            if held is not None:
                normal[0, :], normal[:, 0], normal[0, 0], gradient[0] = 0.0, 0.0, 1.0, 0.0
            scale = 1 / np.sqrt(np.diag(normal))
            inverse = np.linalg.inv(normal * np.outer(scale, scale)) * np.outer(scale, scale)
            state = state + inverse @ gradient
            residuals, weights, excess = self._reweighted(state, weights)
        return _Solution(state, inverse * max(excess, 1.0), residuals, weights)

    def _first_weight(self, state: Array, view: PlateView) -> Array:
        """Weights (cells, 3) before a camera's factors are known: what lies far off a view's bulk is shadow or dirt."""
        used, left = view.information > 0, self._left(state, view)
        size = left - np.nan_to_num(_median(np.where(used, left, np.nan)))
        return np.where(used, biweight(size, max(bulk_deviation(size[used]), _LEAST_SPREAD)), 0.0)

    def _left(self, state: Array, view: PlateView) -> Array:
        """Found less predicted (cells, 3), 0 where nothing was found."""
        return np.where(view.information > 0, view.log_value - self._model(state, view), 0.0)

    def _system(self, state: Array, weights: Sequence[Array]) -> tuple[Array, Array]:
        """Normal matrix and gradient; each camera's factors in the cells are eliminated (Schur's complement)."""
        normal, gradient = self._priors(state)
        for camera in self.cameras:
            shared = np.zeros((CELLS**2, 3, len(state)))
            total, pull = np.full((CELLS**2, 3), VIGNETTE_SIGMA**-2), np.zeros((CELLS**2, 3))
            for view, weight in self._of(camera, weights):
                information, left, columns = weight * view.information, self._left(state, view), self._columns(view)
                slopes = self._slopes(state, view)
                weighted = information[..., None] * slopes
                normal[np.ix_(columns, columns)] += weighted.reshape(-1, 10).T @ slopes.reshape(-1, 10)
                gradient[columns] += weighted.reshape(-1, 10).T @ left.ravel()
                shared[..., columns] += weighted
                total += information
                pull += information * left
            flat = shared.reshape(-1, len(state))
            normal -= flat.T @ (flat / total.reshape(-1, 1))
            gradient -= flat.T @ (pull / total).ravel()
        return normal, gradient

    def _of(self, camera: str, weights: Sequence[Array]) -> list[tuple[PlateView, Array]]:
        return [(view, weight) for view, weight in zip(self.views, weights, strict=True) if view.camera == camera]

    def _priors(self, state: Array) -> tuple[Array, Array]:
        lamps = len(self.known.names)
        normal, gradient = np.zeros((len(state), len(state))), np.zeros(len(state))
        places = slice(1, 1 + 3 * lamps)
        information = np.linalg.inv(self.known.covariance_m2)
        normal[places, places] = information
        gradient[places] = information @ (self.known.positions_m.ravel() - state[places])
        normal[0, 0], gradient[0] = FALLOFF_SIGMA**-2, (INVERSE_SQUARE - state[0]) / FALLOFF_SIGMA**2
        # Intensities are free but for a dust of belief, which keeps those of unseen lamps determined.
        numbers = np.arange(1 + 3 * lamps, len(state))
        normal[numbers, numbers] = np.where(numbers < 1 + 6 * lamps, 1e3, SENSITIVITY_SIGMA) ** -2.0
        # Intensities are in what the cameras count on average.
        ours = (numbers[numbers >= 1 + 6 * lamps]).reshape(-1, 3).T
        for channel in ours:
            normal[np.ix_(channel, channel)] += MEAN_SENSITIVITY_SIGMA**-2
        gradient[numbers] = -normal[np.ix_(numbers, numbers)] @ state[numbers]
        return normal, gradient

    def _reweighted(self, state: Array, weights: Sequence[Array]) -> tuple[list[Array], list[Array], float]:
        """Residuals once the cells' factors are taken off, weights by them, and their mean square over the noise."""
        factors = {camera: self._factors(state, camera, weights) for camera in self.cameras}
        residuals = [self._left(state, view) - factors[view.camera] for view in self.views]
        renewed, squares, count = [], 0.0, 0
        for view, left in zip(self.views, residuals, strict=True):
            size, used = left * np.sqrt(view.information), view.information > 0
            weight = np.where(used, biweight(size, max(bulk_deviation(size[used]), 1.0)), 0.0)
            renewed.append(weight)
            squares += float(np.sum(weight * size**2))
            count += int(np.count_nonzero(weight))
        freedom = max(count - len(state) - len(self.cameras) * 3 * CELLS**2, 1)
        return residuals, renewed, squares / freedom

    def _factors(self, state: Array, camera: str, weights: Sequence[Array]) -> Array:
        """Logarithm (cells, 3) of a camera's factor in each cell and channel."""
        total, pull = np.full((CELLS**2, 3), VIGNETTE_SIGMA**-2), np.zeros((CELLS**2, 3))
        for view, weight in self._of(camera, weights):
            total += weight * view.information
            pull += weight * view.information * self._left(state, view)
        return np.asarray(pull / total, np.float64)

    def describe(self, solution: _Solution, falloff: tuple[float, float]) -> WhiteFit:
        lamps = len(self.known.names)
        places = slice(1, 1 + 3 * lamps)
        lights = slice(1 + 3 * lamps, 1 + 6 * lamps)
        seen = np.zeros((lamps, 3), bool)
        for view in self.views:
            seen[self.known.names.index(view.lamp)] |= view.seen
        log_intensity = np.where(seen, solution.state[lights].reshape(lamps, 3), np.nan)
        variance = np.where(seen, np.diag(solution.covariance)[lights].reshape(lamps, 3), np.nan)
        found = LampPlaces(
            self.known.names, solution.state[places].reshape(lamps, 3), solution.covariance[places, places]
        )
        every = np.concatenate([r[w > 0] for r, w in zip(solution.residuals, solution.weights, strict=True)])
        residual = float(np.sqrt(np.mean(every**2)))
        return WhiteFit(found, log_intensity, variance, *falloff, float(solution.state[0]), residual)


def _median(left: Array) -> Array:
    """Median over the cells of each channel (3,), NaN where there is none."""
    return np.array([np.median(c[np.isfinite(c)]) if np.isfinite(c).any() else np.nan for c in left.T])
