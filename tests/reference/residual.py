"""s . H = delta by the pseudo-inverse, one texel and channel at a time."""

import numpy as np


def fit(delta, half, weights, rank_tolerance):
    """s (texel, channel, 3) and rank, with NaN where no sample counts; shapes as in processing.residual."""
    texels, channels = delta.shape[1:]
    vectors, rank = np.full((texels, channels, 3), np.nan), np.zeros((texels, channels), int)
    for texel in range(texels):
        rows = half[:, texel] if half.ndim == 3 else half
        for channel in range(channels):
            root = np.sqrt(weights[:, texel, channel])
            if not root.any():
                continue
            system, right = rows * root[:, None], np.where(root > 0, delta[:, texel, channel], 0.0) * root
            singular = np.linalg.svd(system, compute_uv=False)
            rank[texel, channel] = np.count_nonzero(singular > rank_tolerance * singular[0])
            vectors[texel, channel] = np.linalg.pinv(system, rcond=rank_tolerance) @ right
    return vectors, rank
