"""Plain NumPy twin of the resampling kernel: every subpoint against every pixel."""

import numpy as np


def resample(value, variance, corners_px, share, reach):
    """Means (n, m, c) and variances of images (c, h, w) over texels with corners (n + 1, m + 1, 2)."""
    channels, height, width = value.shape
    rows, columns = corners_px.shape[0] - 1, corners_px.shape[1] - 1
    mean = np.full((rows, columns, channels), np.nan)
    spread = mean.copy()
    for r, s in np.ndindex(rows, columns):
        c00, c01, c10, c11 = (corners_px[r + i, s + j] for i in (0, 1) for j in (0, 1))
        if not np.isfinite(c00 + c01 + c10 + c11).all():
            continue
        across = max(1, int(np.ceil(max(np.linalg.norm(c01 - c00), np.linalg.norm(c11 - c10)))))
        down = max(1, int(np.ceil(max(np.linalg.norm(c10 - c00), np.linalg.norm(c11 - c01)))))
        a = ((np.arange(across) + 0.5) / across)[None, :, None]
        b = ((np.arange(down) + 0.5) / down)[:, None, None]
        uv = ((1 - b) * ((1 - a) * c00 + a * c01) + b * ((1 - a) * c10 + a * c11)).reshape(-1, 2)
        x = np.maximum(1 - np.abs(np.arange(width) - uv[:, :1]) / reach, 0)
        y = np.maximum(1 - np.abs(np.arange(height) - uv[:, 1:]) / reach, 0)
        weight = np.einsum("py,px->yx", y, x) / (across * down * reach**2)
        for c in range(channels):
            w = np.where(np.isfinite(value[c]), weight, 0)
            if w.sum() >= 0.5 * share[c]:
                mean[r, s, c] = np.nansum(w * value[c]) / w.sum()
                spread[r, s, c] = np.nansum(np.where(w > 0, w**2 * variance[c], 0)) / w.sum() ** 2
    return mean, spread
