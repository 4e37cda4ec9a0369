"""The exposures that a stack really had: shutter errors and lamp flicker, by what its frames say of the same pixels."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from math import exp, log

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.csgraph import connected_components
from scipy.stats import chi2

from processing.errors import ImageError
from processing.radiometry.overlap_kernel import overlap_sums
from processing.radiometry.sensor import Sensor

Array = NDArray[np.float64]

GROSS = 1.2  # a time that is wrong by more than this factor was not flicker
SYSTEMATIC = 5e-3  # what a sensor's nonlinearity may feign; smaller departures are not corrected
LINEARISED = 1e-3  # the same where the nonlinearity was measured
_SIGNIFICANT = 4.0  # standard deviations
_MARGIN = 5.0  # standard deviations of a sample below saturation within which its level is not used
_LEVEL_RATIO = 3.0  # dark pixels are kept from bright ones: they weigh less
_LINK = 100.0  # information that links two frames: their ratio is known to 10 %
_CLEAR = 100.0  # squared signal over noise of a group: its own rate's noise feigns 1 % of information at most
_CLEAR_DN = 20.0  # mean counts over black of a group's frame that counts: black levels are off by tenths of a count
_OUTLIER = 1e-4  # share of undisturbed blocks that the outlier test rejects
_PASSES, _ITERATIONS = 5, 25
_STEP = 1e-7
_SETTLED = 5e-3  # change of a log scale that moves no level's usable frames beyond the margin
_FIRST_LOOK_PX = 40_000


class TimesVerdict(IntEnum):
    """What the frames say of their stated exposure times."""

    CONSISTENT = 0  # they hold within their uncertainty, or within what a sensor's nonlinearity feigns
    CORRECTED = 1  # departures beyond the noise, as of flicker and shutters: the measured times are used
    CONTRADICTED = 2  # a frame departs by more than `GROSS`: swapped or wrong times, or another light
    UNDETERMINED = 3  # no two frames overlap in level: the stated times are all that there is


@dataclass(frozen=True, eq=False)
class ExposureTimes:
    """Stated and measured exposure times of a stack's frames, (k,) each.

    `scale` is true over stated exposure, 1 where the overlap does not determine it; `sigma` its standard deviation,
    there infinite. Gauge: the stated times are right on the average of their logarithms, over the frames that are
    not gross. `disturbed_share` of the compared pixels lie where the frames disagree: something moved. Departures
    under `systematic` are not told from the sensor's nonlinearity.
    """

    stated_s: Array
    scale: Array
    sigma: Array
    disturbed_share: float
    systematic: float = SYSTEMATIC

    @property
    def verdict(self) -> TimesVerdict:
        """Whether the stated times hold."""
        if not np.isfinite(self.sigma).any():
            return TimesVerdict.UNDETERMINED
        if self.gross.size:
            return TimesVerdict.CONTRADICTED
        departure = np.abs(np.log(self.scale))
        beyond = departure > np.maximum(_SIGNIFICANT * self.sigma, self.systematic)
        return TimesVerdict.CORRECTED if beyond.any() else TimesVerdict.CONSISTENT

    @property
    def measured_s(self) -> Array:
        """Stated times scale by what the frames say."""
        return self.stated_s * self.scale

    @property
    def exposure_s(self) -> Array:
        """The times to merge with: measured ones where they differ beyond the noise, else as stated."""
        changed = self.verdict in (TimesVerdict.CORRECTED, TimesVerdict.CONTRADICTED)
        return self.measured_s if changed else self.stated_s

    @property
    def gross(self) -> NDArray[np.intp]:
        """Frames whose time is wrong by more than the factor `GROSS`, beyond doubt."""
        return np.flatnonzero(np.abs(np.log(self.scale)) > log(GROSS) + _SIGNIFICANT * self.sigma)

    @property
    def swapped(self) -> bool:
        """Whether the gross frames have one another's stated times, each within `GROSS`."""
        stated, measured = np.sort(self.stated_s[self.gross]), np.sort(self.measured_s[self.gross])
        return len(stated) > 1 and bool((np.abs(np.log(measured / stated)) < log(GROSS)).all())


def exposure_times(
    raw_dn: NDArray[np.generic], exposure_s: ArrayLike, sensor: Sensor, systematic: float = SYSTEMATIC
) -> ExposureTimes:
    """Relative exposures of frames (k, h, w), or patches of them (k, n, h, w), by maximum likelihood.

    Over squares of neighbouring pixels of one level, a frame's sum Y_i has mean n R T_i and variance
    n (R T_i + read variance); R of each group and the T_i are solved jointly by Fisher scoring. Which frames count at
    a pixel is decided by their common estimate, which is sufficient: the ratios do not depend on the choice. Groups
    that disagree beyond the chi-square distribution (moved parts) do not count, nor frames with little light in one,
    which a black level that is off would distort. The error is within 5 % of the Cramer-Rao bound of the given pixels.
    Raises ImageError where the stack's shape and the exposures disagree or a time is not positive.
    """
    patches, stated_s = _checked(raw_dn, exposure_s)
    alive = np.array([bool((frame < sensor.white_dn).any()) for frame in patches])  # False for NaN too
    scale, sigma, disturbed_share = np.ones(len(stated_s)), np.full(len(stated_s), np.inf), 0.0
    if alive.sum() > 1:
        fit = _measured(patches if alive.all() else patches[alive], stated_s[alive], sensor)
        scale[alive], sigma[alive] = _gauged(fit)
        disturbed_share = fit.disturbed_share
    return ExposureTimes(stated_s, scale, sigma, disturbed_share, systematic)


def times_error(times: ExposureTimes, names: Sequence[str]) -> ImageError:
    """What to tell where the stated times are contradicted: which files, stated and measured, and what to do."""
    listed = "; ".join(
        f"{names[i]} states {times.stated_s[i]:.4g} s and measures {times.measured_s[i]:.4g} s" for i in times.gross
    )
    if len(names) == 2 and not times.swapped:
        stated, measured = (exp(abs(log(t[1] / t[0]))) for t in (times.stated_s, times.measured_s))
        both = " and ".join(f"{name} ({time:.4g} s)" for name, time in zip(names, times.stated_s, strict=True))
        return ImageError(
            f"wrong exposure times: of {both} one is stated to have {stated:.4g} times the other's light and has "
            f"{measured:.4g} times. Correct the times, take one again, or merge with the measured times."
        )
    if times.swapped:
        return ImageError(f"swapped exposure times: {listed}. Correct them, or merge with the measured times.")
    return ImageError(
        f"wrong exposure times, by what the exposures share: {listed}. The light or the aperture changed, or the time "
        "is wrong: leave the file out, take it again, or merge with the measured times."
    )


def _checked(raw_dn: NDArray[np.generic], exposure_s: ArrayLike) -> tuple[NDArray[np.generic], Array]:
    stack, stated_s = np.asarray(raw_dn), np.asarray(exposure_s, np.float64)
    if stack.ndim not in (3, 4) or stated_s.shape != stack.shape[:1] or stack.size == 0:
        raise ImageError(f"stack of shape {stack.shape} with {stated_s.size} exposure times; (k, h, w) and k needed.")
    if not (np.isfinite(stated_s) & (stated_s > 0)).all():
        raise ImageError(f"exposure times must be positive and finite, not {stated_s.tolist()} s.")
    patches = stack[:, None] if stack.ndim == 3 else stack
    return (patches if patches.dtype == np.uint16 else patches.astype(np.float32)), stated_s


def _measured(patches: NDArray[np.generic], stated_s: Array, sensor: Sensor) -> "_Fit":
    """Gather and solve in turn, until the scales move no pixel to other frames."""
    log_scale = _first_look(patches, stated_s, sensor)
    for _ in range(_PASSES):
        fit = _solve(_Groups.gather(patches, stated_s * np.exp(log_scale), sensor), stated_s, log_scale, sensor)
        change, log_scale = np.abs(fit.log_scale - log_scale).max(), fit.log_scale
        if change < _SETTLED:
            break
    return fit


def _first_look(patches: NDArray[np.generic], stated_s: Array, sensor: Sensor) -> Array:
    """Log scales to a few percent, without trust in any time: median ratios along the order of brightness."""
    pixels = patches.reshape(len(patches), -1)
    pixels = pixels[:, :: max(1, pixels.shape[1] // _FIRST_LOOK_PX)].astype(np.float64)
    electrons = (np.clip(np.nan_to_num(pixels, nan=sensor.black_dn), 0, sensor.white_dn) - sensor.black_dn) * (
        sensor.gain_e_per_dn
    )
    clear = (electrons > 10 * np.sqrt(sensor.dark_variance_e2)) & (electrons < 0.9 * sensor.saturation_e)
    brightness = np.argsort(electrons.mean(axis=1), kind="stable")
    log_scale = np.zeros(len(stated_s))
    for one, other in itertools.pairwise(brightness):
        both = clear[one] & clear[other]
        log_scale[other] = log_scale[one]
        if np.count_nonzero(both) >= 50:
            ratio = np.median(np.log(electrons[other, both] / electrons[one, both]))
            log_scale[other] += ratio - log(stated_s[other] / stated_s[one])
    return log_scale - np.median(log_scale)


@dataclass(frozen=True, eq=False)
class _Groups:
    """Sums (g, k) in electrons over `count` (g,) pixels, and which of them count."""

    electrons: Array
    count: Array
    used: NDArray[np.bool_]

    @classmethod
    def gather(cls, patches: NDArray[np.generic], exposure_s: Array, sensor: Sensor) -> "_Groups":
        order, frames = np.argsort(exposure_s, kind="stable"), len(exposure_s)
        rising_s = exposure_s[order]
        edges = _level_edges(rising_s, sensor)
        numbers = (sensor.black_dn, sensor.white_dn, sensor.gain_e_per_dn, sensor.dark_variance_e2)
        sums, counts = overlap_sums(patches[order], rising_s, numbers, _ceiling(rising_s, sensor), edges)
        used = np.arange(frames) <= np.minimum(np.arange(counts.shape[-1]), frames - 1)[:, None]
        time_s, count = np.where(used, rising_s, 0.0), np.maximum(counts, 1)[..., None]
        rate = sums.sum(axis=-1, keepdims=True) / (count * time_s.sum(axis=-1, keepdims=True))
        used = used & (rate * rising_s > _CLEAR_DN * sensor.gain_e_per_dn)
        back, kept = np.argsort(order), (counts > 0) & (used.sum(axis=-1) > 1)
        return cls(np.where(used, sums, 0.0)[kept][:, back], counts[kept].astype(np.float64), used[kept][:, back])


def _ceiling(exposure_s: Array, sensor: Sensor) -> Array:
    """Rate (k,) up to which no noise saturates a frame."""
    top_e = sensor.saturation_e - _MARGIN * np.sqrt(sensor.saturation_e + sensor.dark_variance_e2)
    return np.asarray(max(top_e, 0.5 * sensor.saturation_e) / exposure_s, np.float64)


def _level_edges(rising_s: Array, sensor: Sensor) -> Array:
    """Rates that part the levels of which every frame sees all; what is lost in noise alone stays together."""
    bright, dark = sensor.saturation_e / rising_s[-1], _MARGIN * np.sqrt(sensor.dark_variance_e2) / rising_s[-1]
    return np.geomspace(min(dark, bright), bright, max(2, int(np.ceil(log(bright / dark) / log(_LEVEL_RATIO)))))


@dataclass(frozen=True, eq=False)
class _Fit:
    """Log scales (k,) in no gauge, their information (k, k), its excess noise, and the share of pixels left out."""

    log_scale: Array
    information: Array
    excess: float
    disturbed_share: float


def _solve(groups: _Groups, stated_s: Array, log_scale: Array, sensor: Sensor) -> _Fit:
    frames = len(stated_s)
    if len(groups.count) == 0:
        return _Fit(np.zeros(frames), np.zeros((frames, frames)), 1.0, 0.0)
    degrees = groups.used.sum(axis=1) - 1
    of_degrees = np.asarray(chi2.isf([[_OUTLIER], [0.5]], np.arange(1, frames)))  # once for each, of many groups
    limit, middle = of_degrees[:, degrees - 1]
    fit = _Fit(log_scale, np.zeros((frames, frames)), 1.0, 0.0)
    for _ in range(_ITERATIONS):
        share, score, misfit = _scores(groups, stated_s * np.exp(fit.log_scale), sensor.dark_variance_e2)
        excess = float(np.median(misfit / middle))
        excess = excess if excess > 1 + 4 / np.sqrt(len(misfit)) else 1.0  # beyond the median's own scatter
        kept = (misfit < limit * excess) & (share.sum(axis=1) > _CLEAR)
        weight = share[kept]
        information = np.diag(weight.sum(axis=0)) - weight.T @ (weight / weight.sum(axis=1, keepdims=True))
        step = np.clip(_pseudo_inverse(information) @ score[kept].sum(axis=0), -1.0, 1.0)
        disturbed = groups.count[misfit >= limit * excess].sum() / groups.count.sum()
        fit = _Fit(fit.log_scale + step, information, excess, float(disturbed))
        if np.abs(step).max() < _STEP:
            break
    return fit


def _scores(groups: _Groups, exposure_s: Array, dark_variance: float) -> tuple[Array, Array, Array]:
    """Information and score of the log scales (g, k) with each group's own rate at its optimum; chi-square (g,)."""
    time_s = np.where(groups.used, exposure_s, 0.0)
    n = groups.count[:, None]
    rate = groups.electrons.sum(axis=1, keepdims=True) / (n * time_s.sum(axis=1, keepdims=True))
    for _ in range(6):
        variance = n * (np.maximum(rate, 0.0) * time_s + dark_variance)
        rate = (groups.electrons * time_s / variance).sum(1, keepdims=True) / (n * time_s**2 / variance).sum(
            1, keepdims=True
        )
    mean = n * np.maximum(rate, 1e-12) * time_s
    variance = mean + n * dark_variance
    residual = np.where(groups.used, groups.electrons - n * rate * time_s, 0.0)
    return mean**2 / variance, mean * residual / variance, (residual**2 / variance).sum(axis=1)


def _pseudo_inverse(information: Array) -> Array:
    """Inverse over what is determined, with the links between separate sets of frames cut."""
    label = _linked(information)
    links = np.where(label == label[:, None], -information, 0.0)  # of a Laplacian: rows and columns sum to zero
    np.fill_diagonal(links, 0.0)
    laplacian = np.diag(links.sum(axis=1)) - links
    return np.asarray(np.linalg.pinv(laplacian, rcond=1e-10, hermitian=True), np.float64)


def _linked(information: Array) -> NDArray[np.int32]:
    """Number of the set (k,) to which each frame belongs by links of more than `_LINK`."""
    _, label = connected_components(-information > _LINK, directed=False)
    return np.asarray(label, np.int32)


def _gauged(fit: _Fit) -> tuple[Array, Array]:
    """Scales of the largest set of linked frames and their deviations, in the gauge of `ExposureTimes`."""
    frames = len(fit.log_scale)
    scale, sigma = np.ones(frames), np.full(frames, np.inf)
    label = _linked(fit.information)
    members = np.flatnonzero(label == np.bincount(label).argmax())
    if len(members) > 1:
        log_scale = fit.log_scale[members]
        trusted = np.abs(log_scale - np.median(log_scale)) < log(GROSS)
        mean = (trusted if trusted.any() else np.ones(len(members))) / max(1, trusted.sum() or len(members))
        project = np.eye(len(members)) - np.outer(np.ones(len(members)), mean)
        covariance = project @ _pseudo_inverse(fit.information[np.ix_(members, members)]) @ project.T
        scale[members] = np.exp(project @ log_scale)
        sigma[members] = np.sqrt(np.maximum(np.diag(covariance), 0.0) * fit.excess)
    return scale, sigma
