"""How the back photograph of a fish-eye pair is turned against the front one, from what both see at the seam."""

from dataclasses import dataclass, replace
from enum import IntEnum

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from processing import geometry
from processing.cameras.lens import Fisheye
from processing.errors import ImageError
from processing.products.arrays import Float32, Float64
from processing.robust import biweight, bulk_deviation

HALF_TURN = np.diag([-1.0, 1.0, -1.0])  # about the camera's vertical
_RIM = 0.985  # of the field: beyond, the rim's blur is seen
_FLOOR = 1e-3  # of the mean light
_SEARCH_RAD, _SEARCH_STEPS = np.radians(16.0), 9
_LEVELS_RAD = tuple(np.radians(width) for width in (1.6, 0.7, 0.3))
_AZIMUTHS, _ROWS = 1080, 25
_ROUNDS = 12
_TRIED, _APART_RAD = 8, np.radians(3.0)  # turns of the search that are refined, and how far apart they are
_KEPT = 2  # of them, on finer pictures too
_STILL_RAD = 1e-5
_SCALE_SIGMA = 0.005  # of the focal length, as it is believed before
_LEAST_OVERLAP = 0.3  # of the ring's samples
_LEAST_LIKENESS = 0.8
_MOST_SIGMA_RAD = np.radians(0.5)
_SLOW = 0.025  # of a turn: what varies more slowly, sky and ground, is alike everywhere
_CORRELATED = 20.0  # samples of the ring that tell the same


class RegistrationStatus(IntEnum):
    """Whether front and back were brought together."""

    ALIGNED = 0
    NO_OVERLAP = 1  # the field is too narrow, or the seam is clipped or masked: nothing to compare
    DISAGREE = 2  # what both should see differs: other places, other fields of view, or people that moved
    FEATURELESS = 3  # nothing at the seam tells the turn


@dataclass(frozen=True, eq=False)
class Registration:
    """`front_from_back` (3, 3) rotates directions; `exposure_ratio` multiplies the back to fit the front.

    `lens` has the focal length at which both agree best. `sigma_rad` is the deviation of the turn about its least
    certain axis, `likeness` the correlation of log light at the seam without its slow changes, `overlap` the share of
    the seam's ring that was compared.
    """

    front_from_back: Float64
    exposure_ratio: float
    lens: Fisheye
    sigma_rad: float
    likeness: float
    overlap: float
    status: RegistrationStatus

    def check(self) -> None:
        """Raises ImageError that says why, where they were not brought together."""
        if self.status is RegistrationStatus.NO_OVERLAP:
            raise ImageError(
                f"front and back share {self.overlap:.0%} of the seam, too little to compare: a wrong field of view, "
                "photographs of different places, or a lens of under 180 deg. Give the turn between them to join them "
                "all the same."
            )
        if self.status is RegistrationStatus.DISAGREE:
            raise ImageError(
                f"front and back differ where both look (correlation {self.likeness:.2f}): photographs of different "
                "places, or a wrong field of view. Give the turn between them to join them all the same."
            )
        if self.status is RegistrationStatus.FEATURELESS:
            raise ImageError(
                f"nothing at the seam tells the turn (+- {np.degrees(self.sigma_rad):.1f} deg): give it instead."
            )


@dataclass(frozen=True, eq=False)
class View:
    """Linear `luminance` (h, w) of one photograph, NaN where unknown, and its `usable` (h, w) pixels."""

    luminance: NDArray[np.floating]
    usable: NDArray[np.bool_]


def register(front: View, back: View, lens: Fisheye, field_rad: float) -> Registration:
    """Turn, exposure ratio and focal length that bring the back photograph to fit the front one at the seam.

    Logarithms of blurred light are compared over the ring of directions that both see: every turn within 16 deg of
    half a turn on a coarse grid, the most alike by correlation first, then least squares with Tukey's weights by
    Gauss-Newton on finer and finer pictures. Turns are those of a hand: parallax is not looked for.
    """
    reach = 0.5 * field_rad * _RIM
    seams = [_Seam.of(front, back, lens, reach, width) for width in _LEVELS_RAD]
    state, thin = _State(HALF_TURN, 0.0, 0.0), [seam.thinned(2, 3) for seam in seams]
    tried = [_refined(thin[0], replace(state, turn=turn)) for turn in _search(seams[0])]
    tried = sorted(tried, key=lambda one: -_worth(thin[0], one))[:_KEPT]
    for seam in thin[1:]:
        tried = [_refined(seam, one) for one in tried]
    if tried:
        state = _refined(seams[-1], max(tried, key=lambda one: _worth(thin[-1], one)))
    return _judged(seams[-1], state)


@dataclass(frozen=True, eq=False)
class _State:
    """What is solved for: the turn, log of the exposure ratio, log of the focal length's factor."""

    turn: Float64
    log_ratio: float
    log_scale: float

    def moved(self, step: Float64) -> "_State":
        by = geometry.rigid_from_vectors(step[:3], np.zeros(3))[:3, :3]
        return _State(by @ self.turn, self.log_ratio + step[3], self.log_scale + step[4])


@dataclass(frozen=True, eq=False)
class _Seam:
    """Log pictures of both, and directions (rows, azimuths, 3) around the front's seam."""

    front: Float32
    back: Float32
    lens: Fisheye
    reach_rad: float
    directions: Float64

    @classmethod
    def of(cls, front: View, back: View, lens: Fisheye, reach_rad: float, width_rad: float) -> "_Seam":
        rows = np.linspace(min(np.pi - reach_rad, reach_rad - 0.02), reach_rad, _ROWS, dtype=np.float64)
        one, other = (_log(view, lens, reach_rad, width_rad) for view in (front, back))
        return cls(one, other, lens, reach_rad, _ring(rows, _AZIMUTHS))

    def thinned(self, rows: int, azimuths: int) -> "_Seam":
        """Fewer of the directions."""
        return replace(self, directions=self.directions[::rows, ::azimuths])

    def compared(self, state: _State) -> tuple[Float64, Float64]:
        """Log light of front and back, scaled, at the directions; NaN where one of them does not see."""
        matrix = self.lens.matrix.copy()
        matrix[[0, 1], [0, 1]] *= np.exp(state.log_scale)
        lens = replace(self.lens, matrix=matrix)
        one = _look(self.front, lens, self.directions, self.reach_rad)
        other = _look(self.back, lens, self.directions @ state.turn, self.reach_rad)
        return one, other + state.log_ratio


def _ring(polar_rad: Float64, azimuths: int) -> Float64:
    around = 2 * np.pi * np.arange(azimuths) / azimuths
    level = np.sin(polar_rad)[:, None]
    parts = level * np.cos(around), level * np.sin(around), np.cos(polar_rad)[:, None] + 0 * around
    return np.stack(parts, axis=-1)


def _log(view: View, lens: Fisheye, reach_rad: float, width_rad: float) -> Float32:
    """Logarithm of light blurred by an angle, over what is usable alone; NaN where that is little."""
    # The dark border beyond the rim would darken what is near it, in both pictures alike.
    known = view.usable & np.isfinite(view.luminance) & _within(view.usable.shape, lens, reach_rad)
    light = np.where(known, view.luminance, 0.0).astype(np.float32)
    floor = _FLOOR * float(light[known].mean()) if known.any() else 1.0
    log = np.where(known, np.log(np.maximum(light, np.float32(max(floor, 1e-30)))), 0.0).astype(np.float32)
    sigma_px = max(width_rad * float(lens.matrix[0, 0]), 0.7)
    weight = cv2.GaussianBlur(known.astype(np.float32), (0, 0), sigma_px)
    blurred = cv2.GaussianBlur(log, (0, 0), sigma_px)
    return np.where(known & (weight > 0.3), blurred / np.maximum(weight, 0.3), np.nan).astype(np.float32)


def _within(shape: tuple[int, ...], lens: Fisheye, reach_rad: float) -> NDArray[np.bool_]:
    """Pixels (h, w) no farther from the axis than that."""
    rim = np.array([[np.sin(reach_rad), 0.0, np.cos(reach_rad)]])
    most = float(lens.project(rim)[0, 0] - lens.matrix[0, 2]) / lens.matrix[0, 0]
    rows, columns = np.indices(shape)
    x, y = (columns - lens.matrix[0, 2]) / lens.matrix[0, 0], (rows - lens.matrix[1, 2]) / lens.matrix[1, 1]
    return np.asarray(np.hypot(x, y) <= most)


def _look(log: Float32, lens: Fisheye, directions: Float64, reach_rad: float) -> Float64:
    flat = directions.reshape(-1, 3)
    across = np.hypot(flat[:, 0], flat[:, 1])
    polar = np.arctan2(across, flat[:, 2])
    uv_px = lens.project(flat)
    uv_px[~(polar <= reach_rad)] = np.nan
    at = np.nan_to_num(uv_px, nan=-9.0).astype(np.float32)
    found = cv2.remap(log, at[None, :, 0], at[None, :, 1], cv2.INTER_LINEAR, borderValue=np.nan)[0]
    found[~(polar <= reach_rad)] = np.nan
    return np.asarray(found.reshape(directions.shape[:-1]), np.float64)


def _search(seam: _Seam) -> list[Float64]:
    """The turns of a grid that are most alike by correlation, some degrees apart; none where there is no overlap."""
    if seam.reach_rad <= np.pi / 2:
        return []
    seam = seam.thinned(6, 6)
    steps = np.linspace(-_SEARCH_RAD, _SEARCH_RAD, _SEARCH_STEPS)
    one = _look(seam.front, seam.lens, seam.directions, seam.reach_rad)
    scored = []
    for about in np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3):
        turn = geometry.rigid_from_vectors(about, np.zeros(3))[:3, :3] @ HALF_TURN
        other = _look(seam.back, seam.lens, seam.directions @ turn, seam.reach_rad)
        if (score := _correlation(one, other, _LEAST_OVERLAP)) > 0:
            scored.append((score, about, turn))
    chosen: list[tuple[Float64, Float64]] = []
    for _, about, turn in sorted(scored, key=lambda entry: -entry[0]):
        if all(np.linalg.norm(about - taken) > _APART_RAD for taken, _ in chosen):
            chosen.append((about, turn))
        if len(chosen) == _TRIED:
            break
    return [turn for _, turn in chosen]


def _correlation(one: Float64, other: Float64, least: float) -> float:
    both = np.isfinite(one) & np.isfinite(other)
    if both.mean() < least:
        return -1.0
    a, b = one[both] - one[both].mean(), other[both] - other[both].mean()
    return float(a @ b / max(np.sqrt((a @ a) * (b @ b)), 1e-12))


def _refined(seam: _Seam, state: _State) -> _State:
    for _ in range(_ROUNDS):
        solved = _normal_equations(seam, state)
        if solved is None:
            return state
        matrix, right, _ = solved
        step = np.linalg.solve(matrix, right)
        size = float(np.linalg.norm(step[:3]))
        state = state.moved(step * min(1.0, np.radians(2.0) / max(size, 1e-12)))
        if size < _STILL_RAD:
            break
    return state


def _normal_equations(seam: _Seam, state: _State) -> tuple[Float64, Float64, float] | None:
    """Normal equations of a step of turn, ratio and scale, and the errors' deviation; None without overlap."""
    one, other = seam.compared(state)
    error = one - other
    if np.isfinite(error).mean() < 0.3 * _LEAST_OVERLAP:
        return None
    columns = []
    for i, change in enumerate((2e-3, 2e-3, 2e-3, 0.0, 1e-3)):
        step = np.zeros(5)
        step[i] = change
        if i == 3:
            columns.append(np.ones_like(error))
            continue
        ahead, behind = (seam.compared(state.moved(way * step)) for way in (1, -1))
        columns.append(((ahead[1] - ahead[0]) - (behind[1] - behind[0])) / (2 * change))
    design = np.stack(columns, axis=-1)
    known = np.isfinite(error) & np.isfinite(design).all(axis=-1)
    if known.sum() < 50:
        return None
    # Rows near the poles of the ring are as long as others: all weigh alike.
    left, design = error[known], design[known]
    sigma = max(bulk_deviation(left - np.median(left)), 1e-3)
    weights = biweight(left - np.median(left) if abs(np.median(left)) > 3 * sigma else left, sigma)
    matrix = design.T @ (weights[:, None] * design)
    matrix[4, 4] += _CORRELATED * (sigma / _SCALE_SIGMA) ** 2
    right = design.T @ (weights * left)
    right[4] -= _CORRELATED * (sigma / _SCALE_SIGMA) ** 2 * state.log_scale
    return matrix + 1e-9 * np.trace(matrix) * np.eye(5), right, sigma


def _judged(seam: _Seam, state: _State) -> Registration:
    one, other = seam.compared(state)
    both = np.isfinite(one) & np.isfinite(other)
    overlap, likeness = float(both.mean()), _likeness(one, other)
    solved = _normal_equations(seam, state)
    sigma_rad = np.inf
    if solved is not None:
        covariance = np.linalg.inv(solved[0])[:3, :3] * solved[2] ** 2 * _CORRELATED
        sigma_rad = float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))
    matrix = seam.lens.matrix.copy()
    matrix[[0, 1], [0, 1]] *= np.exp(state.log_scale)
    status = RegistrationStatus.ALIGNED
    if overlap < _LEAST_OVERLAP or solved is None:
        status = RegistrationStatus.NO_OVERLAP
    elif not sigma_rad < _MOST_SIGMA_RAD:
        status = RegistrationStatus.FEATURELESS
    elif likeness < _LEAST_LIKENESS:
        status = RegistrationStatus.DISAGREE
    lens = replace(seam.lens, matrix=matrix)
    ratio = float(np.exp(state.log_ratio))
    return Registration(state.turn, ratio, lens, sigma_rad, likeness, overlap, status)


def _worth(seam: _Seam, state: _State) -> float:
    """Likeness, less where little is compared: small overlaps are alike by chance."""
    one, other = seam.compared(state)
    return _likeness(one, other) * float(np.sqrt(np.mean(np.isfinite(one) & np.isfinite(other))))


def _likeness(one: Float64, other: Float64) -> float:
    """Correlation over the ring after slow changes along it are taken off."""
    both = np.isfinite(one) & np.isfinite(other)
    width = max(_SLOW * one.shape[1], 1.0)
    weight = gaussian_filter1d(both.astype(np.float64), width, axis=1, mode="wrap")
    quick = []
    for picture in (one, other):
        slow = gaussian_filter1d(np.where(both, picture, 0.0), width, axis=1, mode="wrap")
        quick.append(np.where(both, picture - slow / np.maximum(weight, 1e-6), np.nan))
    return _correlation(quick[0], quick[1], 0.3 * _LEAST_OVERLAP)
