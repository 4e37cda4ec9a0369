"""Where a sphere ends in the mean profile across its limb.

Toward the limb the view grazes the surface, and what leaves the surface at grazing angles depends on the material: a
varnished sphere fades to black there, cloth grows brighter. Half of the brightness inside is therefore not where the
sphere ends. The cosine of the view at a depth t inside the limb grows as the root of t, so brightness near the limb is
a + b sqrt(t) + c t for any smooth reflectance, and nothing outside; lens and sampling blur it.
"""

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import least_squares

from processing.products.arrays import Float64

# Of the profile's samples, negative outside. On simulated spheres of 100 and 178 px (seeds 11 to 21) four pixels inside
# left 0.08 px rms of the radius, six left 0.13: farther in, three terms no longer describe a glaze or a lobe.
DEPTHS_PX = np.arange(-4.0, 4.0, 0.25)
_PLATEAU_PX = (1.0, 3.0)  # where a ray's own brightness is read
_LEAST_OF_RAY, _LEAST_OF_ALL = 0.3, 0.1  # share of its own largest brightness, and of the median of these
_FINE_PX = 0.05
_BLUR_PX = (0.3, 0.9, 2.5)  # least, start and most
_FARTHEST_PX = 1.5
_AT_BOUND = 1e-3
_LEAST_HEIGHT = 1e-3  # of a profile that is not flat, over its largest value
_TOLERANCE = 1e-12


def mean_profile(rays: Float64) -> Float64 | None:
    """Mean of rays (light, ray, sample), each over its own brightness, at `DEPTHS_PX`; None where none is lit.

    Every light that reaches a ray counts, not the brightest alone: that would be a highlight at the limb where there is
    one, whose brightness changes too fast.
    """
    inside = (DEPTHS_PX > _PLATEAU_PX[0]) & (DEPTHS_PX < _PLATEAU_PX[1])
    whole = np.isfinite(rays).all(axis=2)
    level = np.where(whole, np.nan_to_num(rays[..., inside].mean(axis=2)), 0.0)
    most = level.max(axis=0)
    bright = level > np.maximum(_LEAST_OF_RAY * most, _LEAST_OF_ALL * np.median(most[most > 0]) if most.any() else 0.0)
    if not bright.any():
        return None
    return np.asarray((rays[bright] / level[bright][:, None]).mean(axis=0), np.float64)


def limb_depth_px(profile: Float64) -> tuple[float, float]:
    """Depth in pixels at which the sphere ends in a profile over `DEPTHS_PX`, and its standard deviation.

    Least squares in blur and depth, with a, b, c and the background solved for each. Where the profile does not tell,
    the depth is NaN.
    """
    least, start, most = _BLUR_PX
    height = float(np.ptp(profile))
    if not height > _LEAST_HEIGHT * np.abs(profile).max():
        return float("nan"), float("nan")
    bounds = ((-_FARTHEST_PX, np.log(least)), (_FARTHEST_PX, np.log(most)))
    found = least_squares(
        _left, (0.0, np.log(start)), bounds=bounds, args=(profile / height,),
        ftol=_TOLERANCE, xtol=_TOLERANCE, gtol=_TOLERANCE,
    )  # fmt: skip
    at_bound = bool((np.abs(found.x - np.array(bounds)) < _AT_BOUND).any())
    freedom = len(profile) - 6
    jacobian = np.asarray(found.jac, np.float64)
    information = jacobian.T @ jacobian * freedom / max(2 * found.cost, 1e-30)
    if not found.success or at_bound or np.linalg.matrix_rank(information) < 2:
        return float("nan"), float("nan")
    return float(found.x[0]), float(np.sqrt(np.linalg.inv(information)[0, 0]))


def _left(at: Float64, profile: Float64) -> Float64:
    """What the best a, b, c and background leave of the profile; the limb itself, a, is not darker than black."""
    columns = _columns(DEPTHS_PX - at[0], float(np.exp(at[1])))
    solved, *_ = np.linalg.lstsq(columns, profile)
    if solved[0] < 0:
        columns = columns[:, 1:]
        solved, *_ = np.linalg.lstsq(columns, profile)
    return np.asarray(columns @ solved - profile, np.float64)


def _columns(depth_px: Float64, blur_px: float) -> Float64:
    """1, sqrt(t) and t inside, nothing outside, blurred; and a background: (sample, 4)."""
    fine = np.arange(DEPTHS_PX[0] - _FARTHEST_PX - 4, DEPTHS_PX[-1] + _FARTHEST_PX + 4 * _BLUR_PX[2], _FINE_PX)
    inside = np.maximum(fine, 0.0)
    shapes = [np.where(fine > 0, 1.0, 0.0), np.sqrt(inside), inside]
    blurred = [np.interp(depth_px, fine, gaussian_filter1d(shape, blur_px / _FINE_PX)) for shape in shapes]
    return np.stack([*blurred, np.ones_like(depth_px)], axis=1)
