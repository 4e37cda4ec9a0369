"""A BTF and the distance function of the same square, as one material: eigenmaps and depths in bytes, no holes."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array, diags_array
from scipy.sparse.linalg import cg

from processing.errors import ImageError
from processing.highlights import white_of
from processing.products import DirectionMesh, Mdf, Mesostructure, Provenance
from processing.products.arrays import Float64
from processing.svd import BtfRows, factor_btf

_SAME_VIEW = np.cos(np.radians(1.0))  # a camera that was calibrated twice is found again within less
_SHOWN = 3  # views that an error names
_TERMS = 8  # coloured eigenmaps, twice the paper's: grey ones lose the hues of a weave, whose texels differ in them
# What a neighbouring view says of a hole over what a neighbouring texel says: the same point of the texels' plane is
# nearly the same point of the surface. At 10 the squared error no longer falls (weave and peanut, seed 2).
_VIEWS_SHARE = 10.0


@dataclass(frozen=True, eq=False)
class Joined:
    """The material, which share of its depths no laser reached: these are guesses, and what its eigenmaps leave.

    `error` is the root of their squared error over the sum of squares, each texel over what it shows in the mean (see
    `factor_btf`), before rounding.
    """

    mesostructure: Mesostructure
    filled: float
    error: float


def mesostructure_from(btf: BtfRows, mdf: Mdf, provenance: Provenance | None = None) -> Joined:
    """Depths of the BTF's views from an MDF of the same square, whose texels lie on the plane of the BTF's.

    The BTF, its glints no brighter than white, becomes eight coloured eigenmaps in bytes, fewer where it has fewer
    views. A depth is D times its ray's cosine, in sides of the square, over one scale for a byte; what was measured
    above the reference plane lies on it. Holes become the smooth surface over texels and views that ends at what was
    measured.
    Raises ImageError where the texels differ, nothing was measured, or a view of the BTF is none of the MDF.
    """
    _check_texels(btf, mdf)
    views = DirectionMesh.from_directions(btf.view_directions)
    depth = np.maximum(mdf.depth_m()[_views_of(views, mdf)] / mdf.side_m, 0.0)
    holes = np.isnan(depth)
    if holes.all():
        raise ImageError("no depth of the views that BTF and MDF share was measured")
    whole = filled(depth, views)
    step = float(whole.max()) / 255 or 1.0
    codes = np.rint(whole / step).astype(np.uint8)
    terms = min(_TERMS, btf.shape[1])
    factors = factor_btf(btf, terms, "colour", white_of(btf))
    coded = factors.btf.coded(np.uint8)
    made = Mesostructure(coded, codes, step, views, mdf.plane_m / mdf.side_m, provenance or Provenance())
    return Joined(made, float(holes.mean()), factors.relative_rmse(terms))


def _check_texels(btf: BtfRows, mdf: Mdf) -> None:
    """Raises ImageError where the grids differ."""
    seen, known = tuple(btf.shape[2:4]), mdf.displacement_m.shape[1:]
    if seen != known:
        raise ImageError(
            f"the BTF has {seen[1]} x {seen[0]} texels and the MDF {known[1]} x {known[0]}: plan both with the same"
        )


def _views_of(views: DirectionMesh, mdf: Mdf) -> NDArray[np.intp]:
    """For each view of the BTF that of the MDF. Raises ImageError that names those that are missing."""
    cosines = views.directions @ mdf.view_directions.T
    missing = np.flatnonzero(~(cosines.max(axis=1) >= _SAME_VIEW))
    if len(missing) == len(cosines):
        raise ImageError("BTF and MDF share no view: plan both with the same cameras and angles of the turntable")
    if len(missing):
        named = ", ".join(_angles(views.directions[view]) for view in missing[:_SHOWN])
        more = f" and {len(missing) - _SHOWN} more" if len(missing) > _SHOWN else ""
        raise ImageError(
            f"{len(missing)} of the BTF's {len(cosines)} views are missing in the MDF ({named}{more}): plan both with "
            "the same cameras and angles of the turntable"
        )
    return np.asarray(cosines.argmax(axis=1))


def _angles(direction: Float64) -> str:
    """Azimuth and elevation in words."""
    azimuth, elevation = np.arctan2(direction[1], direction[0]), np.arcsin(np.clip(direction[2], -1, 1))
    return f"azimuth {np.degrees(azimuth):.0f} deg, elevation {np.degrees(elevation):.0f} deg"


def filled(depth: Float64, views: DirectionMesh) -> Float64:
    """Depth (view, y, x) whose NaN became the mean of their neighbours: four texels, which wrap, and other views.

    The neighbours of a view are those that a triangle of `views` joins it with. Some depth must be known.
    """
    holes = np.isnan(depth)
    if not holes.any():
        return depth
    matrix, known = _equations(depth, holes, views)
    found, _ = cg(matrix, known, np.full(len(known), np.nanmean(depth)), rtol=1e-5)
    whole = depth.copy()
    whole[holes] = np.clip(found, np.nanmin(depth), np.nanmax(depth))
    return whole


def _equations(depth: Float64, holes: NDArray[np.bool_], views: DirectionMesh) -> tuple[csr_array, Float64]:
    """Matrix (n, n) and right side (n,) of n holes: each the weighted mean of its neighbours, known ones on the right.

    Symmetric and positive: what a hole takes of another it gives as well.
    """
    place = np.where(holes, np.cumsum(holes).reshape(holes.shape) - 1, -1)
    total, known = np.zeros(holes.sum()), np.zeros(holes.sum())
    links = []
    for weight, mine, theirs, value in _neighbours(place, depth, views):
        total += np.bincount(mine, minlength=len(total)) * weight
        known += np.bincount(mine, np.where(theirs < 0, weight * np.nan_to_num(value), 0.0), len(total))
        hole = theirs >= 0
        links.append((np.full(hole.sum(), -weight), mine[hole], theirs[hole]))
    values, rows, columns = (np.concatenate(part) for part in zip(*links, strict=True))
    matrix = coo_array((values, (rows, columns)), shape=(len(total),) * 2) + diags_array(total)
    return matrix.tocsr(), known


def _neighbours(
    place: NDArray[np.intp], depth: Float64, views: DirectionMesh
) -> Iterator[tuple[float, NDArray[np.intp], NDArray[np.intp], Float64]]:
    """Weight, numbers (n,) of holes, and number (n,) and depth (n,) of a neighbour of each; -1 numbers what is none."""
    for axis in (1, 2):
        for way in (-1, 1):
            yield 1.0, *_holes_beside(place, np.roll(place, way, axis), np.roll(depth, way, axis))
    sides = views.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    for one, other in np.unique(np.concatenate([sides, sides[:, ::-1]]), axis=0):
        yield _VIEWS_SHARE, *_holes_beside(place[one], place[other], depth[other])


def _holes_beside(
    place: NDArray[np.intp], beside: NDArray[np.intp], depth: Float64
) -> tuple[NDArray[np.intp], NDArray[np.intp], Float64]:
    hole = place >= 0
    return place[hole], beside[hole], depth[hole]
