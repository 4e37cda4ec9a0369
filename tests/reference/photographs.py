"""Plain NumPy twins of the loops over photographs."""

import numpy as np

from processing.radiometry.photograph_kernel import CERTAIN, NEAR_WHITE
from processing.radiometry.response_kernel import BINS, CODES, HUBER, PER_SIGMA


def normal_equations(codes, log_exposure, light, weight, grid):
    """One pixel after the other, as the equations are written."""
    start, per_log, code_at = grid
    frames = len(log_exposure)
    matrix, right, histogram = np.zeros((CODES + frames,) * 2), np.zeros(CODES + frames), np.zeros((CODES, BINS))
    for z in codes:
        measured = (z > 0) & (z < CODES - 1)
        sample = np.where(measured, light[z] / np.exp(log_exposure), 0.0)
        if weight[z].sum() == 0:
            continue
        radiance = np.average(sample, weights=weight[z])
        for _ in range(2):
            places = ((np.log(radiance) + log_exposure - start) * per_log + 0.5).astype(int)
            place = code_at[np.clip(places, 0, len(code_at) - 1)]
            w = np.where(measured, weight[place], 0.0)
            size = np.abs(sample / radiance - 1) * np.sqrt(w)
            w = w * np.minimum(1, HUBER / np.maximum(size, 1e-9))
            if np.count_nonzero(w) < 2:
                break
            radiance = np.average(sample, weights=w)
        if np.count_nonzero(w) < 2:
            continue
        # Row i: what sample i says about the code it is placed at, against the exposure of its frame.
        rows = np.zeros((frames, CODES + frames))
        rows[np.arange(frames), place] += 1
        rows[np.arange(frames), CODES + np.arange(frames)] -= 1
        e = sample / radiance - 1
        matrix += rows.T @ (np.diag(w) - np.outer(w, w) / w.sum()) @ rows
        right -= rows.T @ (w * e)
        for i in np.flatnonzero((w > 0) & (w < 0.9 * w.sum())):
            size = abs(e[i]) * np.sqrt(weight[place[i]] / (1 - w[i] / w.sum()))
            histogram[place[i], min(int(size * PER_SIGMA), BINS - 1)] += 1
    return matrix, right, histogram


def merge_photographs(codes, log_exposure, light, table, grid, ends):
    """Fisher scoring over all pixels of a channel at once."""
    value = np.full(codes.shape[1:], np.nan)
    variance, status = value.copy(), np.ones(codes.shape[1:], np.uint8)
    t = np.exp(log_exposure)[:, None]
    for c in range(codes.shape[-1]):
        z = codes[..., c].reshape(len(t), -1)
        clipped, black = z > ends[c, 1], z < ends[c, 0]
        own_place = ((np.log(light[c]) - grid[0]) * grid[1] + 0.5).astype(int)
        sigma = 1 / np.sqrt(table[c][np.clip(own_place, 0, grid[2] - 1), 0])
        told = np.zeros(z.shape[1])
        for i in np.argsort(log_exposure):
            near = z[i] >= NEAR_WHITE
            clipped[i] |= near & (told * t[i] > light[c, 255])
            least = (light[c] - CERTAIN * sigma)[z[i]] / t[i]
            told = np.where(near, np.maximum(told, least), least)
        measured, sample = ~clipped & ~black, light[c][z]

        def at(log_light, c=c):
            place = ((log_light - grid[0]) * grid[1] + 0.5).astype(int)
            return np.moveaxis(table[c][np.clip(place, 0, grid[2] - 1)], -1, 0)

        own = np.where(measured, at(np.log(sample))[0] * t, 0.0)
        some = own.sum(axis=0) > 0
        r = np.where(some, (own * sample).sum(axis=0) / np.where(some, (own * t).sum(axis=0), 1.0), 1.0)
        for _ in range(20):
            w, above, above_info, below, below_info, sigma = at(np.log(r) + log_exposure[:, None])
            score = t * np.where(measured, w * (sample - r * t), np.where(clipped, above, below))
            information = t * t * np.where(measured, w, np.where(clipped, above_info, below_info))
            total = np.where(some, information.sum(axis=0), 1.0)
            systematic = (np.where(measured, information * sigma, 0)).sum(axis=0)
            systematic = systematic / np.where(some, (measured * information).sum(axis=0), 1.0)
            r = r + np.maximum(score.sum(axis=0) / total, -0.5 * r)
        v = 1 / total + (systematic * r) ** 2
        dark = black.any(axis=0) & ~some
        longest = np.where(black, t, 0).argmax(axis=0)
        r = np.where(dark, sample[longest, np.arange(len(r))] / t[longest, 0], r)
        v = np.where(dark, (light[c, ends[c, 0]] / t[longest, 0]) ** 2, v)
        found = some | dark
        shape = codes.shape[1:3]
        value[..., c] = np.where(found, r, np.nan).reshape(shape)
        variance[..., c] = np.where(found, v, np.nan).reshape(shape)
        status[..., c] = np.where(found, np.where((r * r < 9 * v) | dark, 2, 0), 1).reshape(shape)
    return value, variance, status
