"""Plain NumPy twin of the resampling kernel: every point of a texel against every pixel, tents written out."""

import numpy as np

SEEN, OUT_OF_FIELD, SATURATED, MISSING = range(4)


def resample(value, variance, status, channel, corners_px, reach):
    """Means (n, m, 3), variances and verdicts (n, m) of an image (h, w, p) over texels with corners (n+1, m+1, 2)."""
    height, width, planes = value.shape
    rows, columns = corners_px.shape[0] - 1, corners_px.shape[1] - 1
    mean = np.full((rows, columns, 3), np.nan)
    spread = mean.copy()
    verdict = np.full((rows, columns), OUT_OF_FIELD)
    colour = channel[np.arange(height)[:, None] % 2, np.arange(width) % 2]
    for r, s in np.ndindex(rows, columns):
        weight = _weights([corners_px[r + i, s + j] for i in (0, 1) for j in (0, 1)], (height, width), reach)
        if weight is None:
            continue
        found = []
        for c in range(3):
            of_colour = np.where(colour == c, weight[..., None], 0)
            share = np.mean(np.asarray(channel) == c) * planes
            known = np.isfinite(value)
            w = np.where(known, of_colour, 0)
            saturated = of_colour[~known & (status == 1)].sum()
            missing = of_colour[~known & (status != 1)].sum()
            if saturated > 0.01 * share:
                found.append(SATURATED)
            elif w.sum() >= 0.5 * share:
                found.append(SEEN)
                mean[r, s, c] = np.nansum(w * value) / w.sum()
                spread[r, s, c] = np.nansum(np.where(w > 0, w**2 * variance, 0)) / w.sum() ** 2
            else:
                outside = share - w.sum() - saturated - missing
                found.append(MISSING if missing > outside else OUT_OF_FIELD)
        verdict[r, s] = max(found)
    return mean, spread, verdict


def _weights(corners, shape, reach):
    """Weight of every pixel: points at most half a tent apart, each with a tent of half width `reach`."""
    c00, c01, c10, c11 = corners
    if not np.isfinite(np.stack(corners)).all():
        return None
    across, down = (
        max(1, int(np.ceil(2 / reach * max(np.linalg.norm(b - a), np.linalg.norm(d - c)))))
        for a, b, c, d in ((c00, c01, c10, c11), (c00, c10, c01, c11))
    )
    a = ((np.arange(across) + 0.5) / across)[None, :, None]
    b = ((np.arange(down) + 0.5) / down)[:, None, None]
    uv = ((1 - b) * ((1 - a) * c00 + a * c01) + b * ((1 - a) * c10 + a * c11)).reshape(-1, 2)
    x = np.maximum(1 - np.abs(np.arange(shape[1]) - uv[:, :1]) / reach, 0)
    y = np.maximum(1 - np.abs(np.arange(shape[0]) - uv[:, 1:]) / reach, 0)
    return np.einsum("py,px->yx", y, x) / (across * down * reach**2)
