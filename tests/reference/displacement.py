"""Plain NumPy twin of the merge over laser locations: one pixel at a time."""

import numpy as np

OUTLIER = 4.0


def merge_pixel(values, variances, weights=None, roughness_m=0.0):
    """Displacement, variance, numbers used and rejected of one pixel's samples (k,)."""
    values, variances = np.asarray(values, float), np.asarray(variances, float)
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = 1 / variances if weights is None else np.asarray(weights, float)
    good = np.isfinite(values) & np.isfinite(variances) & (variances > 0) & (weights > 0)
    order = np.flatnonzero(good)[np.argsort(values[good], kind="stable")]
    if order.size == 0:
        return np.nan, np.nan, 0, 0
    value, variance, weight = values[order], variances[order], weights[order]
    agrees = _agreeing(value, variance, weight, roughness_m**2)
    merged, spread = _mean(value, variance, weight, agrees)
    used, rejected = agrees.sum(), (~agrees).sum()
    if rejected >= used:
        spread += ((value[~agrees] - merged) ** 2).max()
    return merged, spread, used, rejected


def _agreeing(value, variance, weight, allowed):
    every = np.ones(len(value), bool)
    near = _near(value, variance, *_mean(value, variance, weight, every))
    if near.all():
        return near
    cost = (value[:, None] - value) ** 2 / (variance + allowed)
    centre = np.argmin(np.minimum(cost, OUTLIER**2).sum(axis=1))
    start = value[centre], variance[centre]
    strict, loose = (_near(value, variance, start[0], start[1] + extra) for extra in (0, allowed))
    rough = 5 * strict.sum() < 4 * loose.sum()
    first = loose if rough else strict
    mean, spread = _mean(value, variance, weight, first)
    second = _near(value, variance, mean, spread + (allowed if rough else 0))
    return second if second.any() else first


def _near(value, variance, centre, spread):
    return (value - centre) ** 2 <= OUTLIER**2 * (variance + spread)


def _mean(value, variance, weight, agrees):
    share = np.where(agrees, weight, 0) / weight[agrees].sum()
    return share @ value, share**2 @ variance
