"""K-means++ and Lloyd's rounds as the text has them: every vector against every centre, in double precision."""

import numpy as np


def squared_distances(values, present, centres):
    """(vector, centre) over the values that are present."""
    return (present[:, None] * (values[:, None].astype(np.float64) - centres) ** 2).sum(axis=2)


def seed(values, present, draws):
    """Rows drawn by their squared distance from those before, of each row of `draws` the best."""
    values = values.astype(np.float64)
    chosen = [int(draws[0, 0] * len(values))]
    nearest = squared_distances(values, present, values[chosen])[:, 0]
    for draw in draws[1:]:
        sums = np.cumsum(nearest)
        rows = np.minimum(np.searchsorted(sums, draw * sums[-1], side="right"), len(values) - 1)
        trial = np.minimum(squared_distances(values, present, values[rows]), nearest[:, None])
        best = trial.sum(axis=0).argmin()
        chosen.append(int(rows[best]))
        nearest = trial[:, best]
    return np.array(chosen)


def rounds(values, present, centres, stop):
    """Centres, index, whether the sum of squares stopped falling, and that sum."""
    values, centres, before = values.astype(np.float64), centres.astype(np.float64), np.inf
    for _ in range(stop[0]):
        distance = squared_distances(values, present, centres)
        index = distance.argmin(axis=1)
        means = np.zeros_like(centres)
        for k in range(len(centres)):
            mine = index == k
            means[k] = values[mine].sum(axis=0) / np.maximum(present[mine].sum(axis=0), 1)
        left = (present * (values - means[index]) ** 2).sum()
        if left >= before * (1 - stop[1]):
            return centres, index, True, before
        before, centres = left, means
    return centres, index, False, before
