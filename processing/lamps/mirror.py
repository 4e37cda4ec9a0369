"""Places of lamps from their images in a mirror ball, all together.

Model: each lamp is fixed in the frame of its carrier, which turns about the rig's Z; the ball rests somewhere near its
seat and is perfectly round; each camera is off by what its calibration leaves open (`camera_doubt`). A highlight lies
where the ball's normal halves the angle between the ways to the lamp and to the camera: an exact reflection, both near.
Several cameras and angles see the same lamp by different normals; that places the ball, and tells distances a little.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import radians

import numpy as np
from numpy.typing import NDArray

from processing.cameras.calibration import CameraModel
from processing.errors import CalibrationError
from processing.lamps.camera_doubt import NUMBERS, reflection_image, sigmas
from processing.lamps.highlight import Highlight
from processing.lamps.model import LampPlaces, NominalLamp, nominal_places
from processing.robust import biweight, bulk_deviation

Array = NDArray[np.float64]
# What is believed before a highlight is seen, one sigma.
SEAT_SIGMA_M = 0.005  # of the ball's centre about its seat
AXIS_SIGMA_RAD = radians(0.005)  # of the angle at which a carrier stands
SPOT_SIGMA_PX = 0.003  # what the shape of a spot adds to its noise
_ROUNDS = 4
_MOST_ITERATIONS = 30
_CONVERGED, _RENEWED = 1e-7, 1e-2  # gains of a step, relative, that end the steps and that ask for new slopes
_STEP = 1e-4  # of the central differences: metres, pixels, radians


@dataclass(frozen=True, slots=True)
class Ball:
    """A mirror ball: where its centre (3,) is meant to be, rig frame, and its radius, metres."""

    seat_m: Array
    radius_m: float


@dataclass(frozen=True, slots=True)
class Sighting:
    """The spots that one camera saw near a lamp's image, the brightest first, its carrier standing at an angle."""

    lamp: str
    camera: str
    angle_rad: float
    spots: tuple[Highlight, ...]


@dataclass(frozen=True, eq=False)
class MirrorFit:
    """Places of the lamps after the mirror ball, and the ball's centre (3,).

    `residual_px` (sightings, 2) is found less predicted, NaN where nothing was seen, and `weight` (sightings,) is 0
    where it took no part. `excess` is the weighted mean square of the residuals over their noise, per degree of
    freedom; the covariance is enlarged by it where it exceeds 1.
    """

    places: LampPlaces
    centre_m: Array
    residual_px: Array
    weight: Array
    excess: float


def locate_lamps(
    sightings: Sequence[Sighting],
    cameras: Mapping[str, CameraModel],
    nominal: Mapping[str, NominalLamp],
    ball: Ball,
) -> MirrorFit:
    """Lamps, ball and shifts that explain all highlights, outliers left out (Tukey's biweight).

    Lamps that no sighting shows stay at their nominal place with the deviation that is believed beforehand. Where a
    sighting has several spots, the brightest starts and the one nearest to the prediction ends.
    Raises CalibrationError where nothing at all was seen, nothing explains it, or a camera or lamp is not known.
    """
    unknown = [s.camera for s in sightings if s.camera not in cameras] + [
        s.lamp for s in sightings if s.lamp not in nominal
    ]
    if unknown:
        raise CalibrationError(f"a highlight belongs to {unknown[0]}, which is not calibrated or not in rig.toml.")
    if not any(sighting.spots for sighting in sightings):
        raise CalibrationError("no lamp was seen in the mirror ball; check its place, the lamps and the exposures.")
    problem = _Problem(tuple(sightings), cameras, nominal, ball)
    brightest = [s.spots[0] if s.spots else None for s in sightings]
    state = problem.solve(problem.start(), _Spots.of(brightest)).state
    predicted = problem.predict(state)
    nearest = [
        min(s.spots, key=lambda spot: float(np.hypot(*(spot.uv_px - uv)))) if s.spots else None
        for s, uv in zip(sightings, predicted, strict=True)
    ]
    spots = _Spots.of(nearest)
    solution = problem.solve(state, spots)
    if not np.isfinite(solution.state).all() or not np.isfinite(solution.weight).all():
        raise CalibrationError("no places of the lamps explain the highlights; check the labels in rig.toml.")
    return problem.describe(solution, spots)


@dataclass(frozen=True, eq=False)
class _Spots:
    """Where highlights were found (n, 2), NaN where none was, and what whitens their noise (n, 2, 2)."""

    uv_px: Array
    whitener: Array

    @classmethod
    def of(cls, chosen: Sequence[Highlight | None]) -> "_Spots":
        uv_px = np.stack([np.full(2, np.nan) if spot is None else spot.uv_px for spot in chosen])
        covariance = np.stack([np.eye(2) if spot is None else spot.covariance_px2 for spot in chosen])
        return cls(uv_px, np.linalg.inv(np.linalg.cholesky(covariance + SPOT_SIGMA_PX**2 * np.eye(2))))

    @property
    def seen(self) -> NDArray[np.bool_]:
        return np.asarray(np.isfinite(self.uv_px).all(axis=1), np.bool_)


@dataclass(frozen=True, eq=False)
class _Solution:
    """All unknowns, the sightings' weights, and the normal matrix with and without the priors."""

    state: Array
    weight: Array
    normal: Array
    measured: Array


@dataclass(frozen=True)
class _Problem:
    """The unknowns are one vector: lamps (3 each), ball (3), doubts of each camera (7), angle of each stand (1)."""

    sightings: tuple[Sighting, ...]
    cameras: Mapping[str, CameraModel]
    nominal: Mapping[str, NominalLamp]
    ball: Ball

    @cached_property
    def lamps(self) -> list[str]:
        return sorted(self.nominal)

    @cached_property
    def seeing(self) -> list[str]:
        return sorted({sighting.camera for sighting in self.sightings})

    @cached_property
    def stands(self) -> list[tuple[str, float]]:
        return sorted({self._stand(sighting) for sighting in self.sightings})

    @cached_property
    def index(self) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp], Array]:
        """Of every sighting: lamp, camera, stand, and the carrier's angle."""
        columns = [
            (self.lamps.index(s.lamp), self.seeing.index(s.camera), self.stands.index(self._stand(s)))
            for s in self.sightings
        ]
        lamp, camera, stand = np.array(columns, np.intp).T
        return lamp, camera, stand, np.array([s.angle_rad for s in self.sightings])

    def _stand(self, sighting: Sighting) -> tuple[str, float]:
        return self.nominal[sighting.lamp].mount, sighting.angle_rad

    def start(self) -> Array:
        """Everything as nominal."""
        places = self._believed.positions_m.ravel()
        return np.concatenate([places, self.ball.seat_m, np.zeros(NUMBERS * len(self.seeing) + len(self.stands))])

    def parts(self, state: Array) -> tuple[Array, Array, Array, Array]:
        """Lamps (n, 3), ball (3,), doubts (cameras, 7), stands (k,)."""
        a = 3 * len(self.lamps)
        b = a + 3 + NUMBERS * len(self.seeing)
        return state[:a].reshape(-1, 3), state[a : a + 3], state[a + 3 : b].reshape(-1, NUMBERS), state[b:]

    def predict(self, state: Array) -> Array:
        """Image points (sightings, 2)."""
        _, centre, doubts, _ = self.parts(state)
        return self._image(self._sources(state), centre, doubts)

    def _sources(self, state: Array) -> Array:
        """Where each sighting's lamp stands (sightings, 3), rig frame."""
        lamp, _, stand, angle_rad = self.index
        places, _, _, turns = self.parts(state)
        return _turned(places[lamp], angle_rad + turns[stand])

    def _image(self, sources: Array, centre: Array, doubts: Array) -> Array:
        _, camera, _, _ = self.index
        uv_px = np.empty((len(sources), 2))
        for number, name in enumerate(self.seeing):
            mine = camera == number
            ball = (centre, self.ball.radius_m)
            uv_px[mine] = reflection_image(self.cameras[name], doubts[number], ball, sources[mine])
        return uv_px

    def _jacobian(self, state: Array) -> Array:
        """Slopes (sightings, 2, unknowns) of `predict`: of the reflection by central differences, the rest by rule."""
        lamp, camera, stand, angle_rad = self.index
        _, centre, doubts, turns = self.parts(state)
        sources, every = self._sources(state), np.arange(len(lamp))
        jacobian = np.zeros((len(lamp), 2, len(state)))
        first_doubt = 3 * len(self.lamps) + 3
        by_source = np.empty((len(lamp), 2, 3))
        for k, step in enumerate(_STEP * np.eye(3)):
            by_source[..., k] = _slope(lambda move: self._image(sources + move, centre, doubts), step)
            by_centre = _slope(lambda move: self._image(sources, centre + move, doubts), step)
            jacobian[..., 3 * len(self.lamps) + k] = by_centre
        for k, axis in enumerate(np.eye(3)):
            turned = _turned(np.broadcast_to(axis, sources.shape), angle_rad + turns[stand])
            jacobian[every, :, 3 * lamp + k] = np.einsum("nij,nj->ni", by_source, turned)
        for k, step in enumerate(_STEP * np.eye(NUMBERS)):
            by_doubt = _slope(lambda move: self._image(sources, centre, doubts + move), step)
            jacobian[every, :, first_doubt + NUMBERS * camera + k] = by_doubt
        around = np.column_stack([-sources[:, 1], sources[:, 0], np.zeros(len(sources))])
        first_stand = first_doubt + doubts.size
        jacobian[every, :, first_stand + stand] = np.einsum("nij,nj->ni", by_source, around)
        return jacobian

    def priors(self, state: Array) -> Array:
        """Departures from what is believed beforehand, in its sigmas; linear in the state."""
        places, centre, doubts, turns = self.parts(state)
        off = self._unsettled @ (places.ravel() - self._believed.positions_m.ravel())
        seat = (centre - self.ball.seat_m) / SEAT_SIGMA_M
        sizes = np.stack([sigmas(self.cameras[name]) for name in self.seeing])
        return np.concatenate([off, seat, (doubts / sizes).ravel(), turns / AXIS_SIGMA_RAD])

    @cached_property
    def _believed(self) -> LampPlaces:
        return nominal_places(self.nominal)

    @cached_property
    def _unsettled(self) -> Array:
        """Whitens departures from the nominal places."""
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self._believed.covariance_m2)), np.float64)

    @cached_property
    def _prior_jacobian(self) -> Array:
        zero = self.priors(np.zeros_like(self.start()))
        return np.column_stack([self.priors(unit) - zero for unit in np.eye(len(self.start()))])

    def solve(self, state: Array, spots: _Spots) -> _Solution:
        """Least squares in rounds, each with the weights that the residuals of the one before give."""
        weight, slopes = spots.seen.astype(np.float64), self._slopes(state, spots)
        for number in range(_ROUNDS):
            if number:
                size = np.linalg.norm(self._whitened(state, spots), axis=1) / np.sqrt(2)
                scale = max(bulk_deviation(size[spots.seen]), 1.0)
                weight = np.where(spots.seen, biweight(np.where(spots.seen, size, 0.0), scale), 0.0)
            solution, slopes = self._minimise(state, slopes, weight, spots)
            state = solution.state
        return solution

    def _slopes(self, state: Array, spots: _Spots) -> Array:
        """Whitened slopes (sightings, 2, unknowns), 0 where nothing was seen."""
        slopes = np.einsum("nij,njk->nik", spots.whitener, self._jacobian(state))
        return np.where(spots.seen[:, None, None], slopes, 0.0)

    def _minimise(self, state: Array, slopes: Array, weight: Array, spots: _Spots) -> tuple[_Solution, Array]:
        """Levenberg-Marquardt; the slopes, which small displacements hardly change, are renewed after large gains."""
        damping, cost, prior = 1e-6, self._cost(state, weight, spots), self._prior_jacobian
        for _ in range(_MOST_ITERATIONS):
            weighted = (slopes * weight[:, None, None]).reshape(-1, len(state))
            measured = weighted.T @ slopes.reshape(-1, len(state))
            normal = measured + prior.T @ prior
            left = np.nan_to_num(self._whitened(state, spots), nan=0.0)
            gradient = weighted.T @ left.ravel() - prior.T @ self.priors(state)
            step, state, damping, new_cost = self._step(state, (normal, gradient, damping), weight, spots)
            gain = (cost - new_cost) / max(new_cost, 1e-300)
            if gain < _CONVERGED or not step.any():
                break
            cost = new_cost
            if gain > _RENEWED:
                slopes = self._slopes(state, spots)
        return _Solution(state, weight, normal, measured), slopes

    def _step(
        self, state: Array, system: tuple[Array, Array, float], weight: Array, spots: _Spots
    ) -> tuple[Array, Array, float, float]:
        """A step that lowers the cost, the state after it, the next damping, and the cost; zero where none does."""
        normal, gradient, damping = system
        here = self._cost(state, weight, spots)
        scale = 1 / np.sqrt(np.diag(normal))
        while damping < 1e9:
            scaled = normal * np.outer(scale, scale) + damping * np.eye(len(state))
            step = scale * np.linalg.solve(scaled, scale * gradient)
            cost = self._cost(state + step, weight, spots)
            if cost <= here:
                return step, state + step, max(damping / 10, 1e-12), cost
            damping *= 10
        return np.zeros_like(state), state, damping, here

    def _cost(self, state: Array, weight: Array, spots: _Spots) -> float:
        whitened = np.nan_to_num(self._whitened(state, spots), nan=0.0)
        return float(np.sum(weight[:, None] * whitened**2) + np.sum(self.priors(state) ** 2))

    def _whitened(self, state: Array, spots: _Spots) -> Array:
        """Found less predicted (sightings, 2) in units of its noise, NaN where nothing was seen."""
        return np.asarray(np.einsum("nij,nj->ni", spots.whitener, spots.uv_px - self.predict(state)), np.float64)

    def describe(self, solution: _Solution, spots: _Spots) -> MirrorFit:
        """The result with its covariance."""
        state, weight = solution.state, solution.weight
        scale = 1 / np.sqrt(np.diag(solution.normal))
        inverse = np.linalg.inv(solution.normal * np.outer(scale, scale)) * np.outer(scale, scale)
        used = weight > 0
        # What the priors, and not the highlights, determine is no freedom spent.
        freedom = max(2 * float(weight.sum()) - float(np.trace(inverse @ solution.measured)), 1.0)
        whitened = self._whitened(state, spots)[used]
        excess = float(np.sum(weight[used, None] * whitened**2)) / freedom
        places, centre, _, _ = self.parts(state)
        covariance = inverse[: places.size, : places.size] * max(excess, 1.0)
        residual_px = spots.uv_px - self.predict(state)
        found = LampPlaces(tuple(self.lamps), places.copy(), covariance)
        return MirrorFit(found, centre.copy(), residual_px, weight, excess)


def _slope(of: Callable[[Array], Array], step: Array) -> Array:
    """Central difference of a function along a step, per unit of it."""
    return (of(step) - of(-step)) / (2 * _STEP)


def _turned(points_m: Array, angle_rad: Array) -> Array:
    """Points (n, 3) turned about Z by angles (n,)."""
    (x, y, z), c, s = points_m.T, np.cos(angle_rad), np.sin(angle_rad)
    return np.column_stack([x * c - y * s, x * s + y * c, z])
