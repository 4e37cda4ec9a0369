"""From normals to a surface: depth by integration, and a mesh."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from processing.errors import ImageError
from processing.materials.integration import Steps, heights
from processing.products import NormalMap, plane_points
from processing.products.arrays import Float64, Int32

_SMALLEST_COSINE = 0.02  # between normal and view: a smaller one tells no slope
_WEIGHTS = (1e-2, 1.0)  # least and most of a step, so that the equations stay well conditioned
_STEEPEST = 8.0  # height over width of a triangle, 83 deg: beyond it lies an edge that the camera sees past


def integrate(normals: NormalMap) -> Float64:
    """Depth toward the camera (y, x) in metres whose slopes are those of the normals; NaN where there is none.

    Each piece of neighbouring pixels with normals has mean depth 0: normals do not tell where a piece lies. Between two
    neighbours the chord is square to the mean of their normals, which is exact on a sphere. Steps count by how well
    their slope is known, and less the more they contradict the others, so that edges where one part hides another bend
    the surface little; how high such an edge is cannot be known.
    """
    known = normals.measured & (normals.normals[..., 2] > _SMALLEST_COSINE)
    normal = np.where(known[..., None], normals.normals, 0.0).astype(np.float64)
    variance = np.where(known, normals.variance, 0.0).astype(np.float64)
    depth = np.full(known.shape, np.nan)
    if known.any():
        rows, columns = (slice(where.min(), where.max() + 1) for where in np.nonzero(known))
        box = (rows, columns)
        relative = _level(heights(_steps(normal[box], variance[box], known[box])), known[box])
        depth[box] = np.where(known[box], relative * normals.pixel_m, np.nan)
    return depth


def triangulate(depth: Float64, pixel_m: float) -> tuple[Float64, Int32, Float64]:
    """Positions (n, 3) in metres, triangles (m, 3) and texture coordinates (n, 2) of a depth map (y, x).

    Vertices are the pixels of triangles, in the view frame; triangles run counter-clockwise seen from the camera, u to
    the right of the picture and v down it. No triangle spans a step steeper than 83 deg.
    Raises ImageError where no three neighbouring pixels have a depth.
    """
    rows, columns = depth.shape
    triangles = _triangles(np.arange(rows * columns).reshape(rows, columns), depth.ravel())
    with np.errstate(invalid="ignore"):
        drop = np.ptp(depth.ravel()[triangles], axis=1)
    used, triangles = np.unique(triangles[drop <= _STEEPEST * pixel_m], return_inverse=True)
    if len(used) == 0:
        raise ImageError("no three neighbouring pixels have a depth: there is no surface to triangulate")
    positions = plane_points((rows, columns), pixel_m).reshape(-1, 3)[used]
    positions[:, 2] = depth.ravel()[used]
    uv = np.stack([(used % columns + 0.5) / columns, (used // columns + 0.5) / rows], axis=1)
    return positions, triangles.reshape(-1, 3).astype(np.int32), uv


def _triangles(index: NDArray[np.intp], depth: Float64) -> NDArray[np.intp]:
    """Two for each square of pixels, cut along the flatter diagonal, or along the only one that is known."""
    a, b, c, d = index[:-1, :-1].ravel(), index[1:, :-1].ravel(), index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    falling, rising = np.abs(depth[a] - depth[c]), np.abs(depth[b] - depth[d])
    cut = (falling <= rising) | np.isnan(rising)
    first = np.where(cut, [a, b, c], [a, b, d])
    second = np.where(cut, [a, c, d], [b, c, d])
    return np.concatenate([first.T, second.T])


def _steps(normal: Float64, variance: Float64, known: NDArray[np.bool_]) -> Steps:
    """Rises between neighbours by their mean normal, weighed by how well the slope is known."""
    right, right_weight, right_flatness = _rises(normal, variance, known, 1)
    down, down_weight, down_flatness = _rises(normal, variance, known, 0)
    both = np.concatenate([right_weight[right_weight > 0], down_weight[down_weight > 0]])
    typical = np.median(both) if both.size else 1.0
    weights = [np.where(w > 0, np.clip(w / typical, *_WEIGHTS), 0.0) for w in (right_weight, down_weight)]
    doubt = float(np.sqrt(np.median(variance[known])))
    return Steps(right, down, weights[0], weights[1], right_flatness, down_flatness, doubt)


def _rises(normal: Float64, variance: Float64, known: NDArray[np.bool_], axis: int) -> tuple[Float64, Float64, Float64]:
    """Rise to the next pixel along an axis, its inverse variance, 0 where there is none, and the cosine to the view."""
    both = np.logical_and(*_neighbours(known, axis))
    mean = np.add(*_neighbours(normal, axis)) / 2
    cosine = np.where(both, mean[..., 2], 1.0)
    rise = np.where(both, (mean[..., 1] if axis == 0 else -mean[..., 0]) / cosine, 0.0)
    doubt = np.maximum(np.add(*_neighbours(variance, axis)), 1e-12)
    return rise, np.where(both, cosine**4 / doubt, 0.0), cosine  # a slope errs by the angle's error over the cosine^2


def _neighbours(values: NDArray[Any], axis: int) -> tuple[NDArray[Any], NDArray[Any]]:
    return (values[:-1], values[1:]) if axis == 0 else (values[:, :-1], values[:, 1:])


def _level(height: Float64, usable: NDArray[np.bool_]) -> Float64:
    """Heights less the mean of each connected piece."""
    pieces = ndimage.label(usable)[0].ravel()
    mean = np.bincount(pieces, height.ravel()) / np.maximum(np.bincount(pieces), 1)
    return height - mean[pieces].reshape(height.shape)
