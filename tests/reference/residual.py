"""The residual of one texel and channel after another, by the pseudo-inverse."""

import numpy as np


def fit(delta, basis, weights, rank_tolerance):
    """Coefficients (texel, channel, k), rank and condition, NaN, 0 and infinity where no sample counts.

    `delta` and `weights` are (direction, texel, channel), `basis` (direction, texel, k).
    """
    texels, channels = delta.shape[1:]
    found = np.full((texels, channels, basis.shape[-1]), np.nan)
    rank, condition = np.zeros((texels, channels), int), np.full((texels, channels), np.inf)
    for texel in range(texels):
        for channel in range(channels):
            root = np.sqrt(weights[:, texel, channel])
            if not root.any():
                continue
            system, right = basis[:, texel] * root[:, None], np.where(root > 0, delta[:, texel, channel], 0.0) * root
            singular = np.linalg.svd(system, compute_uv=False)
            kept = singular[singular > rank_tolerance * singular[0]]
            rank[texel, channel], condition[texel, channel] = len(kept), kept[0] / kept[-1]
            found[texel, channel] = np.linalg.pinv(system, rcond=rank_tolerance) @ right
    return found, rank, condition


def products(columns, basis, value, weights, rank_tolerance):
    """Inner products (c + 1, c + 1) of columns (c, direction) and value (direction,), those less their best residual.

    `basis` is (direction, k), of full rank or less.
    """
    root = np.sqrt(weights)
    rows = np.concatenate([columns, value[None]]) * root
    system = basis * root[:, None]
    left = rows - (system @ np.linalg.pinv(system, rcond=rank_tolerance) @ rows.T).T
    return rows @ rows.T, left @ left.T
