"""Photometric stereo of one pixel in plain NumPy, by the formulas: least median of squares, then the biweight."""

import numpy as np


def grey_samples(value, variance):
    """Value and variance (light,) of the channels (light, 3) weighed together; NaN where none is known."""
    whole = np.isfinite(value).all(axis=1)
    shares = np.maximum(value[whole], 0).sum(axis=0)
    shares = shares * 3 / shares.sum() if shares.sum() > 0 else np.ones(3)
    noise = variance + (1e-6 * np.nanmax(value)) ** 2
    weight = np.where(np.isfinite(value) & np.isfinite(noise), shares**2 / noise, 0.0).sum(axis=1)
    total = np.where(np.isfinite(value) & np.isfinite(noise), shares * value / noise, 0.0).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(weight > 0, total / weight, np.nan), np.where(weight > 0, 1 / weight, np.nan)


def start(grey, variance, vector, triples):
    """Scaled normal of least median squared error, and its relative variance beyond the noise."""
    use = grey > 0.03 * np.sort(grey)[-4] + 3 * np.sqrt(variance)
    grey, variance, vector = grey[use], variance[use], vector[use]
    middle = (len(grey) + 4) // 2 - 1
    best, least = None, np.inf
    for triple in triples[len(grey)]:
        if triple[0] < 0:
            break
        three = vector[triple]
        if abs(np.linalg.det(three)) < 1e-3 * np.linalg.norm(three, axis=1).prod():
            continue
        b = np.linalg.solve(three, grey[triple])
        median = np.sort((grey - vector @ b) ** 2)[middle]
        if median < least:
            best, least = b, median
    near = (grey - vector @ best) ** 2 <= (2.5 * 1.4826 * (1 + 5 / (len(grey) - 3))) ** 2 * least
    plane = np.linalg.lstsq(vector[near], grey[near], rcond=None)[0]
    freedom = max(near.sum() - 3, 1)
    bulk = ((grey - vector @ plane)[near] ** 2).sum() / freedom / (1 - 2 / (9 * freedom)) ** 3
    return best, (bulk - variance.mean()) / (best @ best)


def refined(grey, variance, vector, b, misfit):
    """Scaled normal and weights of the reweighted least squares."""
    fourth = np.sort(grey)[-4]
    for _ in range(30):
        model = vector @ b
        cast = (grey < 0.03 * fourth) & (model - grey > 3 * np.sqrt(variance))
        sigma2 = variance + misfit * (b @ b)
        weight = np.clip(1 - (grey - model) ** 2 / (4.685**2 * sigma2), 0, None) ** 2 / sigma2
        weight = np.where((model > 0) & ~cast, weight, 0.0)
        after = np.linalg.solve((vector * weight[:, None]).T @ vector, vector.T @ (weight * grey))
        if np.abs(after - b).max() < 1e-10 * np.abs(b).max():
            break
        b = after
    return b, weight


def lambertian(images, lights):
    """Scaled normals (y, x, 3) by what textbooks do with images (light, y, x, 3): least squares of all, missing = 0."""
    grey = np.nan_to_num(images).mean(axis=-1)
    return np.einsum("ji,iyx->yxj", np.linalg.pinv(lights), grey)
