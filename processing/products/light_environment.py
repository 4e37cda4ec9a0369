"""Light from all around as a cubemap of radiance."""

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.products.arrays import Float32, Float64
from processing.products.provenance import Provenance, read_description, write_description

KIND = "environment"
_FILE = "environment.exr"
# Per face: the axis it faces, and those along which columns and rows run (OpenGL 4.6, table 8.19).
_FACES = np.array([
    [[1, 0, 0], [0, 0, -1], [0, -1, 0]],
    [[-1, 0, 0], [0, 0, 1], [0, -1, 0]],
    [[0, 1, 0], [1, 0, 0], [0, 0, 1]],
    [[0, -1, 0], [1, 0, 0], [0, 0, -1]],
    [[0, 0, 1], [1, 0, 0], [0, -1, 0]],
    [[0, 0, -1], [-1, 0, 0], [0, -1, 0]],
], dtype=np.float64)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Environment:
    """Linear `radiance` (6, n, n, 3) float32 that arrives from every direction, faces +X -X +Y -Y +Z -Z.

    Directions point away from the scene, in the rig frame with +Z up. Within a face, rows and columns run as OpenGL's
    cube maps have them, so that the faces can be uploaded as they are. A texel is the mean over its solid angle.
    `radiance` is in the unit of its source, which `provenance` says. Raises ImageError for other shapes, and for values
    that are negative or no numbers.
    """

    radiance: Float32
    provenance: Provenance = field(default_factory=Provenance)

    def __post_init__(self) -> None:
        shape = self.radiance.shape
        if len(shape) != 4 or shape[0] != 6 or shape[1] != shape[2] or shape[3] != 3 or not shape[1]:
            raise ImageError(f"an environment is a cubemap (6, n, n, 3), not {shape}")
        if self.radiance.dtype != np.float32:
            raise ImageError(f"an environment is float32, not {self.radiance.dtype}")
        if not (np.isfinite(self.radiance).all() and self.radiance.min() >= 0.0):
            raise ImageError("an environment holds values that are negative or no numbers: that is no light")

    @property
    def size(self) -> int:
        """Texels along the side of a face."""
        return int(self.radiance.shape[1])

    @property
    def directions(self) -> Float64:
        """Unit vectors (6, n, n, 3) through the texels' middles."""
        return cube_directions(self.size)

    @property
    def solid_angles(self) -> Float64:
        """Solid angle (6, n, n) of each texel; together 4 pi."""
        return np.broadcast_to(cube_solid_angles(self.size), self.radiance.shape[:3])

    @property
    def integral(self) -> Float64:
        """Radiance over the whole sphere (3,): the sum of radiance times solid angle."""
        return np.asarray(np.einsum("fyx,fyxc->c", self.solid_angles, self.radiance.astype(np.float64)))

    def evaluate(self, directions: NDArray[np.floating]) -> Float64:
        """Radiance (..., 3) from directions (..., 3) of any length, linear between texels, across edges too."""
        rows = np.asarray(directions, np.float64).reshape(-1, 3)
        index, weight = cube_taps(rows, self.size)
        found = np.einsum("nt,ntc->nc", weight, self.radiance.reshape(-1, 3)[index].astype(np.float64))
        return np.asarray(found.reshape(*np.shape(directions)[:-1], 3), np.float64)

    def irradiance(self, normals: NDArray[np.floating]) -> Float64:
        """What all the light sheds on surfaces that face `normals` (k, 3): (k, 3), radiance times steradians."""
        weighted = (self.radiance * self.solid_angles[..., None]).reshape(-1, 3).astype(np.float64)
        toward = self.directions.reshape(-1, 3)
        return np.stack([np.maximum(toward @ normal, 0.0) @ weighted for normal in np.asarray(normals, np.float64)])

    def save(self, folder: Path) -> None:
        """Write environment.exr (the faces under one another, float32) and product.json."""
        folder.mkdir(parents=True, exist_ok=True)
        strip = self.radiance.reshape(6 * self.size, self.size, 3)
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        channels = {name: np.ascontiguousarray(strip[..., i]) for i, name in enumerate("RGB")}
        with OpenEXR.File(header, channels) as image:
            image.write(str(folder / _FILE))
        content = {"file": _FILE, "size": self.size, "faces": "+X -X +Y -Y +Z -Z, rows as in OpenGL"}
        write_description(folder, KIND, content, self.provenance)

    @classmethod
    def load(cls, folder: Path) -> "Environment":
        """Read what `save` wrote; raises ImageError where the folder holds something else."""
        content, provenance = read_description(folder, KIND)
        try:
            with OpenEXR.File(str(folder / content["file"]), separate_channels=True) as image:
                planes = [np.array(image.channels()[name].pixels, np.float32) for name in "RGB"]
            radiance = np.stack(planes, axis=-1).reshape(6, content["size"], content["size"], 3)
        except (OSError, RuntimeError, ValueError, KeyError) as error:
            raise ImageError(f"{folder / _FILE}: not a whole cubemap; make the environment again") from error
        return cls(radiance, provenance)


def cube_directions(size: int, parts: int = 1) -> Float64:
    """Unit vectors (6, n s, n s, 3) through the middles of the s x s equal parts of each texel's square."""
    return _unit(_cube_points(size * parts))


def _cube_points(count: int) -> Float64:
    place = 2.0 * (np.arange(count) + 0.5) / count - 1.0
    across, down = np.meshgrid(place, place)
    axis, columns, rows = (_FACES[:, None, None, i] for i in range(3))
    return np.asarray(axis + across[..., None] * columns + down[..., None] * rows)


def _unit(vectors: Float64) -> Float64:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def cube_solid_angles(size: int) -> Float64:
    """Solid angle (n, n) of each texel of a face, exactly: differences of atan(x y / sqrt(1 + x^2 + y^2))."""
    edge = 2.0 * np.arange(size + 1) / size - 1.0
    x, y = np.meshgrid(edge, edge)
    corner = np.arctan2(x * y, np.sqrt(1.0 + x * x + y * y))
    return np.asarray(corner[1:, 1:] - corner[:-1, 1:] - corner[1:, :-1] + corner[:-1, :-1])


def cube_places(directions: Float64, size: int) -> tuple[NDArray[np.intp], Float64]:
    """Face (k,) of directions (k, 3) and place (k, 2) in it, (column, row) in texels with middles at integers."""
    largest = np.abs(directions).argmax(axis=-1)
    rows = np.arange(len(directions))
    along = directions[rows, largest]
    face = 2 * largest + (along < 0)
    on_face = _FACES[face]
    place = np.einsum("kij,kj->ki", on_face[:, 1:], directions) / np.abs(along)[:, None]
    return face.astype(np.intp), np.asarray(0.5 * size * (place + 1.0) - 0.5)


def cube_taps(directions: Float64, size: int) -> tuple[NDArray[np.intp], Float64]:
    """Flat indices and weights (k, 4) of the texels between which directions (k, 3) lie; weights add up to 1."""
    face, place = cube_places(directions, size)
    first = np.clip(np.floor(place), -1, size - 1).astype(np.intp)
    part = place - first
    table = _bordered(size)
    corners = [(0, 0), (1, 0), (0, 1), (1, 1)]
    index = np.stack([table[face, first[:, 1] + 1 + dy, first[:, 0] + 1 + dx] for dx, dy in corners], axis=-1)
    weights = [(part[:, 0] if dx else 1 - part[:, 0]) * (part[:, 1] if dy else 1 - part[:, 1]) for dx, dy in corners]
    return index, np.stack(weights, axis=-1)


@lru_cache(maxsize=8)
def _bordered(size: int) -> NDArray[np.intp]:
    """Flat index (6, n + 2, n + 2) of each texel and of those of other faces that lie next to a face's edge."""
    place = 2.0 * (np.arange(-1, size + 1) + 0.5) / size - 1.0
    across, down = np.meshgrid(place, place)
    axis, columns, rows = (_FACES[:, None, None, i] for i in range(3))
    points = axis + across[..., None] * columns + down[..., None] * rows
    # A corner beyond a corner has three faces around it and none of its own: any of them serves.
    face, at = cube_places(points.reshape(-1, 3), size)
    texel = np.clip(np.rint(at), 0, size - 1).astype(np.intp)
    return np.asarray((face * size + texel[:, 1]) * size + texel[:, 0]).reshape(6, size + 2, size + 2)
