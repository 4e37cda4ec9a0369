"""Reflectance toward the eye over nodes of the tree of directions that are as fine as the lobe asks for."""

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from processing.lighting.brdfs import evaluate
from processing.lighting.cuts import trailing_zeros as ends_with
from processing.lighting.directions import HEIGHT
from processing.lighting.lobe_heights import BINS, HIGHEST
from processing.products.arrays import Float32, Float64, Int32

UInt8 = NDArray[np.uint8]

_LOWEST = 1e-3  # cosine to the horizon of an eye or a node's middle that lies under it


class Nodes(NamedTuple):
    """First leaves of nodes, that behind the last one too, and the reflectance (k, 3) toward the eye from each.

    A node of a height serves where the squared cosine of its half angle is no more than `limits` (heights,), and lies
    under the horizon as a whole where its cosine is less than `below` (heights,).
    """

    start: Int32
    value: Float64
    limits: Float64
    below: Float64


class Surface(NamedTuple):
    """What light leaves toward the eye: `lit` and `seen` (n, 3) are normals and directions to the eye, in the frame of
    the leaves, whose nodes have the mean directions `means` (2 leaves, 3), node k of height h at leaves / 2^h + k."""

    lit: Float64
    seen: Float64
    kind: int
    parameters: Float64
    table: Float64
    heights: UInt8
    means: Float32


@numba.njit(nogil=True, cache=True)
def room_for_nodes(leaves: int, heights: UInt8) -> Nodes:
    """As many as leaves, not filled, for a lobe of ascending `heights` (see `lobe_heights`)."""
    coarser = HEIGHT - ends_with(leaves)  # heights are told for 2^15 leaves
    limits = np.full(max(HIGHEST - coarser, 0) + 1, np.inf)
    for height in range(1, len(limits)):
        place = np.searchsorted(heights, height + coarser)
        if place > 0:
            limits[height] = max(1 - ((place - 0.5) / (BINS - 1)) ** 2, 0.0) ** 2
    below = -2.5 * np.sqrt(2.0 ** np.arange(len(limits)) / leaves)
    return Nodes(np.empty(leaves + 1, np.int32), np.empty((leaves, 3)), limits, below)


@numba.njit(nogil=True, cache=True)
def write_nodes(surface: Surface, i: int, found: Nodes) -> int:
    """Write the nodes over which one value of the reflectance serves, and return how many.

    Light or eye that lies under the horizon is taken as just above it: a node's middle may where a part of it is not.
    """
    start, value, limits, below, means = found.start, found.value, found.limits, found.below, surface.means
    leaves = len(means) // 2
    start[0] = 0
    if surface.kind == 0:
        value[0, 0], value[0, 1], value[0, 2] = surface.parameters[0], surface.parameters[1], surface.parameters[2]
        start[1] = leaves
        return 1
    nx, ny, nz = surface.lit[i, 0], surface.lit[i, 1], surface.lit[i, 2]
    ex, ey, ez = surface.seen[i, 0], surface.seen[i, 1], surface.seen[i, 2]
    level = np.sqrt(nx * nx + ny * ny)
    tx, ty = (-ny / level, nx / level) if level > 1e-6 else (1.0, 0.0)
    bx, by, bz = -nz * ty, nz * tx, nx * ty - ny * tx
    vx, vy, vz = tx * ex + ty * ey, bx * ex + by * ey + bz * ez, max(nx * ex + ny * ey + nz * ez, _LOWEST)
    nodes, leaf, top = 0, 0, len(limits) - 1
    while leaf < leaves:
        height = top if leaf == 0 else min(ends_with(leaf), top)
        while True:
            node = (leaves >> height) + (leaf >> height)
            x, y, z = means[node, 0], means[node, 1], means[node, 2]
            lz = nx * x + ny * y + nz * z
            if lz < below[height]:
                value[nodes, 0], value[nodes, 1], value[nodes, 2] = 0, 0, 0
                break
            lx, ly, lz = tx * x + ty * y, bx * x + by * y + bz * z, max(lz, _LOWEST)
            along = (lz + vz) * (lz + vz)
            if along <= limits[height] * (along + (lx + vx) * (lx + vx) + (ly + vy) * (ly + vy)):
                f = evaluate(surface.kind, surface.parameters, surface.table, lx, ly, lz, vx, vy, vz)
                value[nodes, 0], value[nodes, 1], value[nodes, 2] = f
                break
            height -= 1
        start[nodes] = leaf
        nodes += 1
        leaf += 1 << height
    start[nodes] = leaves
    return nodes
