"""Sample points on concentric spheres, as the cells of a cube blown up, and the eight of them around any point."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numba
import numpy as np
from numpy.typing import NDArray

from processing.lighting.rays import Bool
from processing.products.arrays import Float32, Float64, Int32

Int64 = NDArray[np.int64]

_EASED = 1.0  # of the body's radius


@dataclass(frozen=True)
class ShellPlan:
    """Spheres from `nearest` to `farthest` radii of a body, `resolution` of them with 6 resolution^2 points each.

    "uniform" spheres are equally far from each other (Iwasaki et al.). Gaps between "growing" ones grow as the distance
    from the centre plus one radius: outside nearly as those between the points of a sphere, and inside, where a ray has
    to be traced in every direction, not down to nothing.
    """

    resolution: int = 32
    spacing: Literal["growing", "uniform"] = "growing"
    nearest: float = 0.2
    farthest: float = 10.0

    def __post_init__(self) -> None:
        if self.resolution < 2 or not 0 < self.nearest < self.farthest < np.inf:
            raise ValueError(f"shells: at least 2 between two radii that grow from above 0, not {self}")

    def around(self, centre: Float64, radius: float) -> "Shells":
        """The spheres of a body with this bounding sphere."""
        eased = _EASED if self.spacing == "growing" else 0.0
        bounds = self.nearest + eased, self.farthest + eased
        spaced = np.geomspace(*bounds, self.resolution) if eased else np.linspace(*bounds, self.resolution)
        return Shells(centre, radius * (spaced - eased), self.resolution)


@dataclass(frozen=True, eq=False)
class Shells:
    """Points on spheres of ascending `radii` (k,) around `centre` (3,), 6 x resolution x resolution on each.

    They are numbered by sphere, face (+X -X +Y -Y +Z -Z), row, column. Across a face they are equal angles apart.
    """

    centre: Float64
    radii: Float64
    resolution: int

    def __len__(self) -> int:
        return len(self.radii) * 6 * self.resolution**2

    def points(self, start: int, stop: int) -> Float64:
        """Positions (stop - start, 3) of some points."""
        shell, place = np.divmod(np.arange(start, stop), 6 * self.resolution**2)
        return np.asarray(self.centre + self.radii[shell, None] * self._sphere[place])

    def cells(self, points: Float64, left_out: Bool | None = None) -> tuple[Int32, Float32]:
        """Numbers and weights (n, 8) of the sample points around points (n, 3).

        Weights sum to 1 and change continuously; inside the first sphere they are those on it, outside the last one
        they are 0. Sample points `left_out` (len,) count only where all eight are.
        """
        found = np.empty((len(points), 8), np.int32), np.empty((len(points), 8), np.float32)
        out = np.zeros(len(self), np.bool_) if left_out is None else left_out
        _cells(np.asarray(points, np.float64) - self.centre, self.radii, self.neighbours, out, *found)
        return found

    @cached_property
    def _sphere(self) -> Float64:
        across = _across(np.arange(self.resolution), self.resolution)
        row, column = np.meshgrid(across, across, indexing="ij")
        return np.concatenate([_on_face(face, column, row).reshape(-1, 3) for face in range(6)])

    @cached_property
    def neighbours(self) -> Int32:
        """Numbers (6, resolution + 2, resolution + 2) on one sphere with the neighbours beyond each edge; -1 beyond
        corners, where only three points meet."""
        n = self.resolution
        place = np.clip(_across(np.arange(-1, n + 1), n), -1 - 1e-9, 1 + 1e-9)
        row, column = np.meshgrid(place, place, indexing="ij")
        numbers = np.stack([_number(_on_face(face, column, row), n) for face in range(6)])
        numbers[:, [0, 0, -1, -1], [0, -1, 0, -1]] = -1
        return numbers


def _across(cell: Int64, resolution: int) -> Float64:
    """Places -1 to 1 of cells' middles."""
    return np.asarray((2 * cell + 1) / resolution - 1)


def _on_face(face: int, u: Float64, v: Float64) -> Float64:
    """Unit vectors (..., 3) at places u, v in -1 to 1 of a face."""
    found = np.empty((*u.shape, 3))
    found[..., face // 2] = 1 - 2 * (face % 2)
    found[..., (face // 2 + 1) % 3] = np.tan(np.pi / 4 * u)
    found[..., (face // 2 + 2) % 3] = np.tan(np.pi / 4 * v)
    return np.asarray(found / np.linalg.norm(found, axis=-1, keepdims=True))


def _number(directions: Float64, resolution: int) -> Int32:
    """Number on its sphere of the cell that each direction (..., 3) lies in."""
    axis = np.abs(directions).argmax(axis=-1)
    main, first, second = (np.take_along_axis(directions, ((axis + k) % 3)[..., None], -1)[..., 0] for k in range(3))
    cells = [np.arctan(side / np.abs(main)) * (4 / np.pi) for side in (first, second)]
    column, row = (np.clip(((cell + 1) / 2 * resolution).astype(np.int64), 0, resolution - 1) for cell in cells)
    return np.asarray(((2 * axis + (main < 0)) * resolution + row) * resolution + column, np.int32)


@numba.njit(cache=True, nogil=True)
def _cells(places: Float64, radii: Float64, neighbours: Int32, left_out: Bool, index: Int32, weight: Float32) -> None:
    for i in range(len(places)):
        find_cell(places[i], radii, neighbours, left_out, index[i], weight[i])


@numba.njit(cache=True, nogil=True)
def find_cell(place: Float64, radii: Float64, neighbours: Int32, left_out: Bool, index: Int32, weight: Float32) -> None:
    """Write the eight numbers and weights around one place (3,), seen from the centre: see `Shells.cells`."""
    resolution = neighbours.shape[1] - 2
    axis = 0
    for k in range(1, 3):
        if abs(place[k]) > abs(place[axis]):
            axis = k
    main = place[axis]
    index[:], weight[:] = 0, 0
    distance = np.sqrt(place[0] * place[0] + place[1] * place[1] + place[2] * place[2])
    if not distance <= radii[-1] * (1 + 1e-9):
        return
    depth = min(max(np.searchsorted(radii, distance) - 1, 0), len(radii) - 2)
    outer = min(max((distance - radii[depth]) / (radii[depth + 1] - radii[depth]), 0.0), 1.0)
    u, v = 0.0, 0.0
    if main != 0:
        u, v = np.arctan(place[(axis + 1) % 3] / abs(main)), np.arctan(place[(axis + 2) % 3] / abs(main))
    u, v = (u * (4 / np.pi) + 1) / 2 * resolution + 0.5, (v * (4 / np.pi) + 1) / 2 * resolution + 0.5
    column, row = min(int(u), resolution), min(int(v), resolution)
    u, v = u - column, v - row
    face, shell = 2 * axis + (1 if main < 0 else 0), 6 * resolution * resolution
    total, seen = 0.0, 0.0
    for corner in range(8):
        high, down, right = corner >> 2, corner >> 1 & 1, corner & 1
        number = neighbours[face, row + down, column + right]
        if number >= 0:
            index[corner] = number + (depth + high) * shell
            share = (outer if high else 1 - outer) * (v if down else 1 - v) * (u if right else 1 - u)
            weight[corner] = share
            total += share
            seen += 0.0 if left_out[index[corner]] else share
    for corner in range(8):
        if seen > 0 and left_out[index[corner]]:
            weight[corner] = 0
        weight[corner] /= seen if seen > 0 else total
