"""Plain NumPy twin of the loop that gathers what several exposures say of the same pixels."""

import numpy as np


def overlap_sums(raw_dn, exposure_s, sensor, ceiling, edges, block_px=32):
    """Sums and counts by patch, block and class, pixel for pixel."""
    black, white, gain, dark = sensor
    frames, patches, height, width = raw_dn.shape
    columns, rows = -(-width // block_px), -(-height // block_px)
    sums = np.zeros((patches, rows * columns, frames + len(edges), frames))
    counts = np.zeros(sums.shape[:3], int)
    for patch, y, x in np.ndindex(patches, height, width):
        dn = raw_dn[:, patch, y, x].astype(float)
        bad = ~np.isfinite(dn) | (dn >= white)
        good = int(np.argmax(bad)) if bad.any() else frames
        electrons = (dn - black) * gain
        for used in range(good, 1, -1):
            e, t = electrons[:used], exposure_s[:used]
            weight = t / (max(e.sum() / t.sum(), 0) * t + dark)
            rate = (weight * e).sum() / (weight * t).sum()
            if rate < ceiling[used - 1]:
                kind = used - 1 + (np.searchsorted(edges, rate) if used == frames else 0)
                block = y // block_px * columns + x // block_px
                counts[patch, block, kind] += 1
                sums[patch, block, kind, :used] += e
                break
    return sums, counts
