"""An environment's light on the leaves of the tree of directions, turned any way, with sums over any run of leaves."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numba
import numpy as np
from scipy.spatial import cKDTree

from processing.errors import GeometryError
from processing.lighting.directions import SampleDirections
from processing.products.arrays import Float32, Float64, Int32
from processing.products.light_environment import Environment, cube_directions, cube_solid_angles

_TABLE = 256  # cells along a cube's side: a third of a degree, a third of the spacing of 32 768 directions
_FINE = 256  # parts along a cube's side that a coarse environment is split into: 12 for each leaf
_AROUND = 8
_ORTHONORMAL = 1e-6


@dataclass(frozen=True, eq=False)
class LeafLight:
    """Light (leaves, 3) from the cell of each direction: radiance times steradians."""

    values: Float64

    @cached_property
    def sums(self) -> Float64:
        """Sums (leaves + 1, 4) before each leaf; the light of leaves i to j is the difference of rows j and i.

        In float64, so that a sun beside a dark sky leaves the sky its digits. The fourth column is 0.
        """
        found = np.zeros((len(self.values) + 1, 4))
        np.cumsum(self.values, axis=0, out=found[1:, :3])
        return found


class EnvironmentLight:
    """An environment, ready to be turned: its texels in parts, each of which falls on one leaf whole.

    The light of all leaves together is the environment's integral, at every turn. An environment that holds NaN,
    infinite or negative values cannot be made (`Environment` raises ImageError); a sun of any finite radiance may be.
    """

    def __init__(self, environment: Environment, sampled: SampleDirections) -> None:
        parts = max(-(-_FINE // environment.size), 1)
        solid = cube_solid_angles(environment.size * parts)[None, :, :, None]
        radiance = environment.radiance.repeat(parts, axis=1).repeat(parts, axis=2)
        light = np.asarray((radiance * solid).reshape(-1, 3), np.float32)
        bright = light.any(axis=1)
        self._light = light[bright]
        self._directions = cube_directions(environment.size, parts).reshape(-1, 3)[bright].astype(np.float32)
        self._sampled = sampled

    def turned(self, frame_from_light: Float64) -> LeafLight:
        """The light on the leaves of a frame that this rotation (3, 3) takes the environment's directions into.

        Raises GeometryError where it is no rotation.
        """
        turn = checked_rotation(frame_from_light)
        found = np.zeros((len(self._sampled.directions), 3))
        _scatter(self._directions, self._light, turn, nearest_leaves(self._sampled), found)
        return LeafLight(found)


def checked_rotation(matrix: Float64) -> Float64:
    """A rotation (3, 3) as float64. Raises GeometryError for a mirror, a stretch or what is not finite."""
    found = np.asarray(matrix, np.float64)
    finite = found.shape == (3, 3) and np.isfinite(found).all()
    if not finite or np.abs(found @ found.T - np.eye(3)).max() > _ORTHONORMAL or np.linalg.det(found) < 0:
        raise GeometryError(f"no rotation: {found.tolist()}")
    return found


def leaves_of(directions: Float64, sampled: SampleDirections) -> Int32:
    """The leaf (n,) whose direction is nearest to each of `directions` (n, 3), by search."""
    return np.asarray(cKDTree(sampled.directions).query(directions, workers=2)[1], np.int32)


def turned_leaves(turn: Float64, sampled: SampleDirections) -> Int32:
    """The leaf (leaves,) nearest to each leaf's direction after a rotation (3, 3), as by `leaves_of` but soon."""
    ways, found = sampled.directions @ turn.T, np.empty(len(sampled.directions), np.int32)
    _climb(ways, sampled.directions, nearest_leaves(sampled), _leaves_around(sampled), found)
    return found


@lru_cache(maxsize=4)
def _leaves_around(sampled: SampleDirections) -> Int32:
    """Each leaf and the nearest others (leaves, 9): its cell's neighbours are among them."""
    return np.asarray(cKDTree(sampled.directions).query(sampled.directions, _AROUND + 1)[1], np.int32)


@numba.njit(cache=True, nogil=True)
def _climb(ways: Float64, directions: Float64, table: Int32, around: Int32, found: Int32) -> None:
    """From the leaf of the table's cell on to the nearest one around, as long as one is nearer."""
    for i in range(len(ways)):
        x, y, z = ways[i, 0], ways[i, 1], ways[i, 2]
        leaf, best = -1, -2.0
        nearer = leaf_at(x, y, z, table)
        while nearer != leaf:
            leaf = nearer
            for other in around[leaf]:
                along = x * directions[other, 0] + y * directions[other, 1] + z * directions[other, 2]
                if along > best:
                    nearer, best = other, along
        found[i] = leaf


@lru_cache(maxsize=4)
def nearest_leaves(sampled: SampleDirections) -> Int32:
    """The leaf of each cell (6, 256, 256) of a cube: face, then places along the next axis and the one after."""
    place = 2 * (np.arange(_TABLE) + 0.5) / _TABLE - 1
    first, second = np.meshgrid(place, place, indexing="ij")
    cells = np.ones((6, _TABLE, _TABLE, 3))
    for face in range(6):
        axis = face // 2
        cells[face, ..., axis] = 1 - 2 * (face % 2)
        cells[face, ..., (axis + 1) % 3], cells[face, ..., (axis + 2) % 3] = first, second
    cells /= np.linalg.norm(cells, axis=-1, keepdims=True)
    return leaves_of(cells.reshape(-1, 3), sampled).reshape(6, _TABLE, _TABLE)


@numba.njit(cache=True, nogil=True)
def leaf_at(x: float, y: float, z: float, table: Int32) -> int:
    """The leaf of a direction of any length, by `nearest_leaves`."""
    count = table.shape[1]
    ax, ay, az = abs(x), abs(y), abs(z)
    if ax >= ay and ax >= az:
        face, u, v = (0 if x > 0 else 1), y / ax, z / ax
    elif ay >= az:
        face, u, v = (2 if y > 0 else 3), z / ay, x / ay
    else:
        face, u, v = (4 if z > 0 else 5), x / az, y / az
    half = 0.5 * count
    row, column = min(max(int((u + 1) * half), 0), count - 1), min(max(int((v + 1) * half), 0), count - 1)
    return int(table[face, row, column])


@numba.njit(cache=True, nogil=True)
def _scatter(directions: Float32, light: Float32, turn: Float64, table: Int32, found: Float64) -> None:
    for i in range(len(directions)):
        a, b, c = directions[i]
        x = turn[0, 0] * a + turn[0, 1] * b + turn[0, 2] * c
        y = turn[1, 0] * a + turn[1, 1] * b + turn[1, 2] * c
        z = turn[2, 0] * a + turn[2, 1] * b + turn[2, 2] * c
        leaf = leaf_at(x, y, z, table)
        for channel in range(3):
            found[leaf, channel] += light[i, channel]
