"""Laser planes frame by frame, as the paper finds them: the peer of one model for the whole sweep.

In each image the stripe's ridge along the scan direction on both heights of the holder's white frame, a threshold, a
robust line through each, and the lines cast to the planes of the two heights (Wang et al. 2005, section 3.2).
"""

import numpy as np

from processing import geometry
from processing.errors import ImageError
from processing.laser.holder import reference_region
from processing.laser.plane_fit import fit_plane
from processing.laser.ridge import stripe_ridge
from processing.laser.stripe import stripe_line

SIGMA_PX = 1.0  # of the red pixels' image: about the stripe's
THRESHOLD_DN = 40.0
DOWN = np.array([0.0, 0.0, -1.0])


def two_height_planes(lines):
    """Normals (t, 3) and offsets (t,) of every frame's own plane through its two lines; NaN where there are not two."""
    planes = [fit_plane(line.reshape(-1, 3)).towards(DOWN) if np.isfinite(line).all() else None for line in lines]
    normals = [np.full(3, np.nan) if plane is None else plane.normal for plane in planes]
    return np.stack(normals), np.array([np.nan if plane is None else plane.offset_m for plane in planes])


def parallel_planes(lines):
    """As the paper: one angle for the sweep, its frames' median, and each frame's line on the reference plane."""
    normal = np.nanmedian(two_height_planes(lines)[0], axis=0)
    normal /= np.linalg.norm(normal)
    return np.broadcast_to(normal, (len(lines), 3)), np.mean(lines[:, 0] @ normal, axis=1)


def stripe_lines(sweep, holder, source_m, frames):
    """Ends (t, 2, 2, 3) of the stripe's lines on both heights in these frames, rig frame; NaN where one is not seen."""
    region = reference_region(sweep.camera, sweep.rig_from_sample, holder, source_m)
    return np.stack([
        [_line_m(sweep, sweep.frames[frame], region.height == part, -holder.step_m * (part - 1)) for part in (1, 2)]
        for frame in frames
    ])  # fmt: skip


def _line_m(sweep, raw_dn, mask, z_m):
    """The two ends (2, 3) of the stripe's line on one height, rig frame; NaN where it is not seen."""
    red, seen = raw_dn[::2, ::2].astype(float), mask[::2, ::2]
    across = _stands_upright(sweep)
    ridge = stripe_ridge(red if across else red.T, SIGMA_PX, THRESHOLD_DN, seen if across else seen.T)
    uv_px = 2.0 * (ridge.uv_px if across else ridge.uv_px[:, ::-1])
    try:
        line = stripe_line(uv_px)
    except ImageError:
        return np.full((2, 3), np.nan)
    along = uv_px[line.inliers] @ np.array([-line.normal[1], line.normal[0]])
    if np.ptp(along) < 4.0:
        return np.full((2, 3), np.nan)
    ends = np.outer([along.min(), along.max()], [-line.normal[1], line.normal[0]]) + line.offset_px * line.normal
    return geometry.intersect_plane(sweep.camera.centre_m, sweep.camera.rays(ends), (0, 0, 1), z_m)


def _stands_upright(sweep):
    """Whether the stripe runs along the image's columns more than along its rows."""
    side = 0.01 * np.array([-np.sin(sweep.mount.azimuth_rad), np.cos(sweep.mount.azimuth_rad), 0.0])
    step = np.abs(np.diff(sweep.camera.project(np.stack([-side, side])), axis=0)[0])
    return step[1] > step[0]
