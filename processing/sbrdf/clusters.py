"""Clusters of what the top does not see: k-means in each view, over all lights and channels.

Source: Chen et al. 2008, section 2.3.3.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from processing.products.arrays import Float32, Float64
from processing.products.sbrdf_packing import TextureLayout
from processing.sbrdf.k_means import k_means, nearest_centre
from processing.sbrdf.samples import Samples
from processing.threads import in_parts


class ClusterStatus(IntEnum):
    """How the k-means of a view ended; the first two are a KMeansStatus."""

    CONVERGED = 0
    STOPPED = 1
    NO_POINTS = 2  # nothing is hidden
    NO_CENTRES = 3  # its points took the nearest centres of other views


@dataclass(frozen=True, eq=False)
class Clusters:
    """`index` (view, y, x) of each hidden point into `centres` (k, light, 3) float32, values; 0 where not hidden.

    `status` (view,) int8 is a ClusterStatus, `error` (view,) the mean squared difference of the hidden points' values
    from their centres', NaN without points. A light that no point of a cluster was measured under has the mean of the
    view's hidden points there, 0 without any.
    """

    index: NDArray[np.uint16]
    centres: Float32
    status: NDArray[np.int8]
    error: Float64

    def reflectance(self, samples: Samples) -> Float32:
        """Centres in 1/sr without the cosine; 0 for lights under the horizon."""
        cosine = samples.light_directions[:, 2:]
        factor = np.divide(samples.scale, cosine, out=np.zeros_like(cosine), where=cosine > 0)
        return np.asarray(self.centres * factor, np.float32)


def centre_count(lights: int, views: int, height: int, width: int) -> int:
    """How many centres the packed texture has room for: 1984 for 81, 81, 64, 64."""
    return TextureLayout(lights, views, height, width).centres


def cluster_hidden(samples: Samples, hidden: NDArray[np.bool_], count: int = 1984) -> Clusters:
    """Centres of the `hidden` (view, y, x) points of each view, at most `count` in all.

    Views share them in proportion to their hidden points. Values that are missing are left out of distances and means.
    The same in every run and any order of the views.
    """
    points = hidden.sum(axis=(1, 2))
    shares = _shares(points, count)
    index = np.zeros(hidden.shape, np.uint16)
    status = np.full(len(hidden), ClusterStatus.NO_POINTS, np.int8)
    error = np.full(len(hidden), np.nan)
    centres = np.zeros((int(shares.sum()), samples.shape[0] * 3), np.float32)
    first, having = np.cumsum(shares) - shares, np.flatnonzero(shares)

    def cluster(start: int, stop: int) -> None:
        for view in having[start:stop]:
            found = k_means(_vectors(samples, hidden, view), int(shares[view]))
            index[view][hidden[view]] = first[view] + found.index
            centres[first[view] : first[view] + shares[view]] = found.centres
            status[view], error[view] = found.status, found.error

    in_parts(cluster, len(having), 1)
    for view in np.flatnonzero((points > 0) & (shares == 0)):
        status[view] = ClusterStatus.NO_CENTRES
        if len(centres):
            index[view][hidden[view]] = nearest_centre(_vectors(samples, hidden, view), centres)
    return Clusters(index, centres.reshape(len(centres), samples.shape[0], 3), status, error)


def _shares(points: NDArray[np.int_], count: int) -> NDArray[np.intp]:
    """Centres of each view: in proportion to its points, largest remainders first, at most one for each point.

    A view with points has at least one, unless there are fewer centres than such views: then those with the most
    points have one each.
    """
    if points.sum() <= count:
        return points.astype(np.intp)
    hidden = points > 0
    if hidden.sum() >= count:
        most = np.argsort(-points, kind="stable")[:count]
        return np.isin(np.arange(len(points)), most).astype(np.intp)
    exact = points * (count / points.sum())
    shares: NDArray[np.intp] = np.maximum(np.floor(exact), hidden).astype(np.intp)
    left = count - int(shares.sum())
    while left < 0:  # what the smallest views have above their part is taken from the others, the best served first
        shares[np.where(shares > 1, exact - shares, np.inf).argmin()] -= 1
        left += 1
    shares[np.argsort(shares - exact, kind="stable")[:left]] += 1
    return shares


def _vectors(samples: Samples, hidden: NDArray[np.bool_], view: np.intp) -> Float32:
    """Values of a view's hidden points (n, light * 3)."""
    values = samples.seen_from(int(view))[:, hidden[view]]
    return np.ascontiguousarray(np.moveaxis(values, 1, 0)).reshape(values.shape[1], -1)
