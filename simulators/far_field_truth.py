"""What a far-field BTF shows: which points, their true shadows, and where the view from the top sees them."""

from dataclasses import dataclass

import numpy as np

from simulators.far_field import first_hits, lit, one_period, ray_places, reflected
from simulators.layout import Array
from simulators.scene import Floats, Mask, Sample


@dataclass(frozen=True, eq=False)
class FarFieldTruth:
    """Truth of the ray through each texel's middle.

    `points_m` (view, y, x, 3) are the points seen, moved into the middle period. `shadowed` (light, view, y, x): the
    point faces away from the light or something blocks it. `hidden` (view, y, x): something lies straight above the
    point. `shift` (view, y, x, 2) float32 in texels, right and down, leads from the texel to the place where the view
    from the top sees the point, NaN where hidden; the short way round the period.
    """

    points_m: Array
    shadowed: Mask
    hidden: Mask
    shift: Floats


def truth(sample: str, seed: int, directions: tuple[Array, Array], texels: int, depth_m: float) -> FarFieldTruth:
    """Truth of `far_field.btf_below` with one ray per texel; the same bits for the same arguments.

    Lights (n, 3) and views (m, 3) of `directions` are unit vectors. A point that lies less under another than the
    sample's pieces sag under their curves (5 or 20 um) is not hidden: it is the same point, seen at a grazing angle.
    Down to 80 deg and over 4 mm a shift is at most 25 mm, less than half of any period: the short way is the true one.
    Raises ValueError for another sample and lower directions.
    """
    return traced(sample, seed, directions, texels, depth_m)[1]


def traced(
    sample: str, seed: int, directions: tuple[Array, Array], texels: int, depth_m: float
) -> tuple[Floats, FarFieldTruth]:
    """`far_field.btf_below` with one ray per texel, and its `truth`, by the same rays."""
    lights, views = directions
    body, period_m = one_period(sample, seed, directions)
    places = ray_places(texels, 1, period_m)
    values = np.zeros((len(lights), len(views), len(places), 3), np.float32)
    shadowed = np.ones(values.shape[:3], np.bool_)
    points = np.full((len(views), len(places), 3), np.nan)
    for v, view in enumerate(views):
        hits = first_hits((body, period_m), places, view, depth_m)
        points[v, hits.ray] = hits.points
        for n, light in enumerate(lights):
            visible = lit(body, hits, light)
            shadowed[n, v, hits.ray] = ~visible
            values[n, v, hits.ray] = reflected(hits, visible, light, view)
    found = _truth(body, (points, points - places), shadowed, period_m, texels)
    return values.reshape(*values.shape[:2], texels, texels, 3), found


def depths(sample: str, seed: int, views: Array, texels: int, depth_m: float) -> Array:
    """Depth (view, y, x) under the plane z = 0 of the point that each texel shows, in metres; NaN where none.

    Texels, views (m, 3) and errors as in `far_field.btf_below`; the ray is that through a texel's middle.
    """
    body, period_m = one_period(sample, seed, (views, views))
    places = ray_places(texels, 1, period_m)
    found = np.full((len(views), len(places)), np.nan)
    for v, view in enumerate(views):
        hits = first_hits((body, period_m), places, view, depth_m)
        found[v, hits.ray] = -hits.points[:, 2]
    return found.reshape(-1, texels, texels)


def _truth(body: Sample, seen: tuple[Array, Array], shadowed: Mask, period_m: float, texels: int) -> FarFieldTruth:
    """That of points (view, texel, 3) and ways to them from their texels."""
    points, way_m = seen
    hidden = _covered(body, points.reshape(-1, 3), period_m).reshape(points.shape[:2])
    shift = (way_m - period_m * np.round(way_m / period_m))[..., :2] * [1, -1] * texels / period_m
    shift[hidden] = np.nan
    square = (texels, texels)
    return FarFieldTruth(
        points.reshape(-1, *square, 3),
        shadowed.reshape(*shadowed.shape[:2], *square),
        hidden.reshape(-1, *square),
        shift.reshape(-1, *square, 2).astype(np.float32),
    )


def _covered(body: Sample, points: Array, period_m: float) -> Mask:
    """Above which points (n, 3) something lies."""
    above = np.nan_to_num(points) * [1.0, 1.0, 0.0]
    hits = body.trace(above, np.broadcast_to([0.0, 0.0, -period_m], above.shape))
    highest = points[:, 2].copy()
    highest[hits.ray] = hits.points[:, 2]
    return np.asarray(~(highest - points[:, 2] <= body.offset_m))
