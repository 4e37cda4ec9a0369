"""Resampling on the sphere that keeps its integral: every sample of the source gives away exactly its own light."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

from processing.products.arrays import Float32, Float64
from processing.products.light_environment import cube_directions, cube_solid_angles

_ROUNDS = 30  # a uniform sky is then uniform to 0.4 %, in the mean to 0.05 %
_CHUNK = 400_000  # directions at a time: what is kept of them is a tenth of what they need


class Samples(Protocol):
    """A picture of the sphere as a list of samples, each with its solid angle."""

    @property
    def radiance(self) -> Float64:
        """Linear (samples, channels)."""

    @property
    def solid_angles(self) -> Float64:
        """Of each sample (samples,), its share of what several pictures show together."""

    @property
    def groups(self) -> NDArray[np.intp]:
        """Number (samples,) of the group of each sample: those of a group give their mean, 0 ... groups - 1."""

    @property
    def spacing_rad(self) -> float:
        """Angle between neighbouring groups where they lie densest."""

    def taps(self, directions: Float64) -> tuple[NDArray[np.intp], Float64]:
        """Indices and weights (k, t) of the samples around directions (k, 3); weights add up to 1."""


@dataclass(frozen=True)
class Targets:
    """Cells of the sphere: their `solid_angles` (cells,), and equal numbers of `directions` (cells, s, 3) in each."""

    directions: Float64
    solid_angles: Float64


def cube_targets(size: int, spacing_rad: float) -> Targets:
    """The texels of a cubemap, with directions as close as the source's samples lie."""
    parts = max(2, int(np.ceil(2.0 / size / spacing_rad)))
    directions = cube_directions(size, parts).reshape(6, size, parts, size, parts, 3).swapaxes(2, 3)
    solid_angles = np.broadcast_to(cube_solid_angles(size), (6, size, size))
    return Targets(directions.reshape(6 * size * size, parts * parts, 3), solid_angles.reshape(-1))


def area_averages(source: Samples, targets: Targets) -> Float32:
    """Mean radiance (cells, channels) over each cell.

    Cells look the source up along their directions. Weights of cells and of groups of samples are then found in turns
    (Sinkhorn's iteration) so that a cell's weights add up to 1 and a group's to its own solid angle; the latter last,
    and so exactly: the integral over the sphere is the source's, also of a sun in a single sample. A group that no
    direction comes near gives its light to none.
    """
    gather, cell_angles = _gather(source, targets), targets.solid_angles
    groups, own = source.groups, source.solid_angles
    group_angles = np.bincount(groups, own)
    light = np.stack([np.bincount(groups, own * channel) for channel in source.radiance.T], axis=-1)
    mean = light / np.maximum(group_angles, np.finfo(float).tiny)[:, None]
    share, rows = np.ones(len(own)), np.ones(len(cell_angles))
    for _ in range(_ROUNDS):
        rows = _inverse(np.asarray(gather @ share, np.float64))
        given = np.bincount(groups, gather.T @ (cell_angles * rows), minlength=len(group_angles))
        share = np.asarray((group_angles * _inverse(np.asarray(given, np.float64)))[groups], np.float64)
    return np.asarray(rows[:, None] * (gather @ (share[:, None] * mean[groups])), np.float32)


def _inverse(values: Float64) -> Float64:
    return np.divide(1.0, values, out=np.zeros_like(values), where=values > 0)


def _gather(source: Samples, targets: Targets) -> csr_array:
    """Mean of what a cell's directions look up: (cells, samples), sparse."""
    cells, parts = targets.directions.shape[:2]
    step = max(_CHUNK // parts, 1)
    blocks = [_rows(source, targets.directions[start : start + step]) for start in range(0, cells, step)]
    return csr_array(vstack(blocks, "csr"))


def _rows(source: Samples, directions: Float64) -> csr_array:
    cells, parts = directions.shape[:2]
    index, weight = source.taps(directions.reshape(-1, 3))
    each = parts * index.shape[1]
    starts = np.arange(0, cells * each + 1, each)
    found = csr_array((weight.ravel() / parts, index.ravel(), starts), shape=(cells, len(source.solid_angles)))
    found.sum_duplicates()
    return found
