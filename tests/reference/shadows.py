"""Plain twins of the sums, gathering and choices that lobes, shadows and places are fitted by."""

import numpy as np


def light_sums(values, weight, drawn):
    """Weighted sums (t, light, 3) of value^2, value times drawn and drawn^2 over views and channels."""
    w, values, drawn = weight[..., None].astype(np.float64), values.astype(np.float64), drawn.astype(np.float64)
    known = np.where(w > 0, values, 0)
    products = (known * known, known * drawn, drawn * drawn)
    return np.stack([(w * product).sum(axis=(2, 3)) for product in products], axis=-1)


def gather_view(seen, place, texels):
    """Sums (t, light, 3) and counts (t, light) of the finite values of the points at each texel."""
    total, count = np.zeros((texels, len(seen), 3)), np.zeros((texels, len(seen)))
    for texel in range(texels):
        mine = seen[:, place == texel]
        known = np.isfinite(mine).all(axis=-1)
        total[texel] = np.where(known[..., None], mine, 0).sum(axis=1)
        count[texel] = known.sum(axis=1)
    return total, count


def nearest_of(seen, drawn, candidates, extra):
    """Candidate (point,) of least squared difference, of what is finite, plus what it costs besides."""
    apart = np.nansum(np.square(seen[:, None].astype(np.float64) - drawn[candidates]), axis=-1) + extra
    return np.argmin(apart, axis=1)


def in_shadow(values, drawn, share, least):
    """Samples (t, s) whose mean over the channels is under a share of their lobes' or of `least` (s,)."""
    return values.mean(axis=-1) < share * np.maximum(drawn.mean(axis=-1), least)
