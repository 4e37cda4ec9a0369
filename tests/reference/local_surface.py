"""The surface at one place, straight from the textbook: every model a matrix, the likelihood of a Gaussian vector."""

import numpy as np
from scipy.stats import norm


def predict(offset, value, variance, models):
    """Value and variance at the origin of samples (k, 2), (k,), (k,) of one place, all measured.

    `models` has `roughness`, `length`, `slope`, `offset`, `gap`, `edge` and `rounds` by name. One surface, or two on
    either side of the largest gap between sorted values.
    """
    median = np.sort(value)[(len(value) - 1) // 2]
    value = value - median
    surfaces = [_answers(offset, value, variance, np.ones(len(value)), np.ones(len(value)), models)]
    steps = np.diff(np.sort(value))
    if steps.max() > models["gap"]:
        label = np.where(value > np.sort(value)[np.argmax(steps)], 1.0, -1.0)
        near = np.sqrt(np.exp(-0.5 * (offset**2).sum(axis=1)))
        basis = np.column_stack([np.ones(len(value)), offset])
        weighted = basis * near[:, None]
        plane = np.linalg.solve(weighted.T @ weighted + 1e-3 * np.eye(3), weighted.T @ (near * label))
        for side in (1.0, -1.0):
            chance = norm.logcdf(side * plane[0] / models["edge"])
            found = _answers(offset, value, variance, label, (label == side).astype(float), models)
            surfaces.append([(mean, spread, evidence + chance) for mean, spread, evidence in found])
    chosen, spread = _decide(surfaces, models["rounds"])
    return chosen + median, spread


def _answers(offset, value, variance, label, side, models):
    """Mean, variance and evidence of every roughness of both kinds."""
    together = label[:, None] == label
    apart = np.linalg.norm(offset[:, None] - offset, axis=-1) / models["length"]
    away = np.linalg.norm(offset, axis=-1) / models["length"]
    found = []
    for covariance in (_rough, _smooth):
        for roughness in models["roughness"]:
            plane = models["offset"] ** 2 + models["slope"] ** 2 * offset @ offset.T
            inner = together * (plane + roughness**2 * covariance(apart)) + np.diag(variance)
            cross = side * (models["offset"] ** 2 + roughness**2 * covariance(away))
            gain = np.linalg.solve(inner, cross)
            evidence = -0.5 * (value @ np.linalg.solve(inner, value) + np.linalg.slogdet(inner)[1])
            found.append((gain @ value, models["offset"] ** 2 + roughness**2 - gain @ cross, evidence))
    return found


def _decide(surfaces, rounds):
    mean, spread, evidence = (np.array([[m[i] for m in models] for models in surfaces]) for i in range(3))
    likelihood = np.exp(evidence - evidence.max())
    weight = likelihood / likelihood.sum()
    for _ in range(rounds):
        weight = likelihood * (1.0 + weight)
        weight /= weight.sum()
    own = np.argmax(weight.sum(axis=1))
    chosen = weight[own] @ mean[own] / weight[own].sum()
    return chosen, (weight * (spread + (mean - chosen) ** 2)).sum()


def _rough(distance):
    return np.exp(-distance)


def _smooth(distance):
    return (1 + np.sqrt(5) * distance + 5 * distance**2 / 3) * np.exp(-np.sqrt(5) * distance)
