"""Range as something to look at: a coloured depth picture, a point cloud file."""

from pathlib import Path

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray

from processing.errors import ImageError


def depth_picture(depth_m: NDArray[np.floating], limits_m: tuple[float, float] | None = None) -> NDArray[np.uint8]:
    """Depth (h, w) in metres as an sRGB picture (h, w, 3): near yellow, far violet, missing (NaN) black.

    Between `limits_m`, or the 2nd and 98th percentiles. Raises ImageError where it is not an image.
    """
    depth = np.asarray(depth_m, np.float64)
    if depth.ndim != 2:
        raise ImageError(f"a depth image (h, w) is needed, not {depth.shape}.")
    known = np.isfinite(depth)
    if not known.any():
        return np.zeros((*depth.shape, 3), np.uint8)
    near, far = limits_m or (float(value) for value in np.percentile(depth[known], [2, 98]))
    share = np.clip((far - np.where(known, depth, far)) / max(far - near, 1e-12), 0.0, 1.0)
    coloured = cv2.applyColorMap((share * 255 + 0.5).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
    return np.where(known[..., None], coloured[..., ::-1], 0).astype(np.uint8)


def write_point_cloud(path: Path, points_m: NDArray[np.floating], colour: NDArray[np.uint8]) -> int:
    """Write the finite points (..., 3) with their sRGB colours (..., 3) as PLY or what the suffix says.

    Returns how many there are. Raises ImageError where no point is finite.
    """
    points = np.asarray(points_m, np.float64).reshape(-1, 3)
    finite = np.isfinite(points).all(axis=1)
    if not finite.any():
        raise ImageError(f"{path}: no measured point to write.")
    trimesh.PointCloud(points[finite], colour.reshape(-1, 3)[finite]).export(path)
    return int(finite.sum())
