"""Plain NumPy twin of the loop that finds the extremes of tiles."""

import numpy as np


def tile_extremes(raw_dn, corners, tile_px, ignored):
    """Least and greatest counts of each tile."""
    found = []
    for row, column in corners:
        part = raw_dn[row : row + tile_px, column : column + tile_px]
        if ignored.size:
            part = part[~ignored[row : row + tile_px, column : column + tile_px]]
        found.append((part.min(initial=65535), part.max(initial=0)))
    return np.array(found, np.uint16).T
