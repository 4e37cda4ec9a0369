"""Skins over a statue: how far borders of charts and cuts between patches show, and what they cost.

Contrast is the mean gradient of radiance along the surface between neighbouring pixels on two sides of a line, over
that between other neighbours within six pixels of it: 1 where nobody could tell. Pictures have about two
pixels for a texel.
`seam_contrast` is that of the charts, of the material where it is farthest from 1; beside it stands the naive mapping:
the same sample, as wide, laid on from the six sides of the bounding box. `skin_s` is the longest of the syntheses.
"""

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy import sparse
from scipy.ndimage import binary_dilation
from scipy.sparse.csgraph import connected_components

from processing.materials.skin import Skin, SkinOptions, drape
from processing.products import Srf
from render.mesh import Mesh, perpendicular
from render.mesh_file import load_mesh
from render.reference import shade
from render.scene import Scene, framed, light
from render.shapes import statue
from render.sights import plain_sight
from service.bench import Result
from tests.benchmarks.yardsticks.skin_samples import skin_sample

REPEATS = 4.0
NEAR_PX = 6
SEED = 11


def run(*, quick: bool) -> Result:
    """Stone, cloth and brick on 84 668 triangles; quick on 10 400 and with fewer texels."""
    body = statue(shape=(88, 60)) if quick else statue()
    texels, size = (48, 360) if quick else (128, 900)
    width = float(np.ptp(body.positions, axis=0).max()) / REPEATS
    coarse, first = statue(shape=(12, 12)), SkinOptions(width, 256, SEED)
    # The first skin also waits for the compiler.
    drape(skin_sample("stone", 48, SEED), coarse.positions, coarse.normals, coarse.triangles, first)
    rows: list[dict[str, object]] = []
    for name in ("stone", "cloth", "brick"):
        sample = skin_sample(name, texels, SEED)
        begun_s = time.perf_counter()
        skin = drape(sample, body.positions, body.normals, body.triangles, SkinOptions(width, 1024, SEED))
        seconds = time.perf_counter() - begun_s
        picture = _drawn(_worn(body, skin), skin.srf, size)
        told = {"size": f"{len(body.triangles)} triangles", "patches": int(skin.patch.max()) + 1}
        rows.append({"method": f"skin, {name}", "seconds": seconds, **told, **picture.contrast(picture.chart),
                     "cuts": picture.contrast(picture.patch(skin))["contrast"]})  # fmt: skip
        naive = _drawn(_boxed(body), sample, size)
        rows.append({"method": f"naive mapping, {name}", **naive.contrast(naive.chart)})
    skins, others = rows[::2], rows[1::2]
    worst = max((float(str(row["contrast"])) for row in skins), key=lambda contrast: abs(np.log(contrast)))
    naive_least = min(float(str(row["contrast"])) for row in others)
    figures = {"seam_contrast": worst, "skin_s": max(float(str(row["seconds"])) for row in skins)}
    return Result(figures, [*rows, {"method": "naive mapping, least contrast", "contrast": naive_least}])


@dataclass(frozen=True, eq=False)
class _Picture:
    """Luminance, place on the surface (h, w, 3), texture coordinates (h, w, 2), chart (h, w), -1 beside the body."""

    luminance: NDArray[np.float64]
    place: NDArray[np.float64]
    uv: NDArray[np.float64]
    chart: NDArray[np.int64]

    def patch(self, skin: Skin) -> NDArray[np.int64]:
        """The patch that each pixel shows."""
        height, width = skin.patch.shape
        row, column = (self.uv[..., 1] * height).astype(int), (self.uv[..., 0] * width).astype(int)
        return np.where(self.chart >= 0, skin.patch[row % height, column % width], -1)

    def contrast(self, label: NDArray[np.int64]) -> dict[str, float]:
        """Contrast of the lines between labels; also by the medians, 95th percentiles and largest of both gradients."""
        across, near = [], []
        for axis in (0, 1):
            first, second = ([slice(None)] * 2 for _ in range(2))
            first[axis], second[axis] = slice(None, -1), slice(1, None)
            one, other = tuple(first), tuple(second)
            apart = np.linalg.norm(self.place[one] - self.place[other], axis=2)
            both = (self.chart[one] >= 0) & (self.chart[other] >= 0)
            # Where the surface goes on behind itself neighbours are far apart.
            both &= apart < 4.0 * np.median(apart[both])
            line = both & (label[one] != label[other])
            # Per length on the surface: the farther two neighbours are apart, the sooner a line runs between them.
            gradient = np.abs(self.luminance[one] - self.luminance[other]) / np.maximum(apart, 1e-12)
            across.append(gradient[line])
            near.append(gradient[both & ~line & binary_dilation(line, iterations=NEAR_PX)])
        on, beside = np.concatenate(across), np.concatenate(near)
        return {
            "contrast": float(on.mean() / beside.mean()),
            "median": float(np.median(on) / np.median(beside)),
            "p95": float(np.quantile(on, 0.95) / np.quantile(beside, 0.95)),
            "worst": float(on.max() / beside.max()),
            "pixels": len(on),
        }


def _drawn(mesh: Mesh, material: Srf, size: int) -> _Picture:
    """The body from before, under a light beside the camera."""
    camera = framed(mesh, (size, size), azimuth_rad=np.radians(-35.0), elevation_rad=np.radians(15.0))
    scene = Scene.of(mesh, material, camera, (light(np.radians(-15.0), np.radians(40.0)),))
    sight, fragments = plain_sight(mesh, camera)
    radiance = shade(scene, scene.bodies[0], sight, None, [np.ones(len(sight.pixel))])
    corners = mesh.triangles
    edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]]])
    joined = sparse.coo_matrix((np.ones(len(edges)), edges.T), shape=(len(mesh.positions),) * 2)
    chart = connected_components(joined, directed=False)[1][corners[fragments.triangle, 0]]

    def image(values: NDArray[np.float64], nothing: float) -> NDArray[np.float64]:
        flat = np.full((size * size, *values.shape[1:]), nothing)
        flat[fragments.pixel] = values
        return flat.reshape(size, size, *values.shape[1:])

    return _Picture(
        image(radiance.mean(axis=1), 0.0),
        image(sight.point, 0.0),
        image(sight.uv, 0.0),
        image(chart.astype(np.float64), -1.0).astype(np.int64),
    )


def _worn(body: Mesh, skin: Skin) -> Mesh:
    normals = body.normals[skin.vertex]
    tangents = np.column_stack([perpendicular(skin.tangents, normals), np.ones(len(normals))])
    return Mesh(body.positions[skin.vertex], normals, tangents, skin.uv, skin.triangles)


def _boxed(body: Mesh) -> Mesh:
    """The body as `rig preview --shape FILE` maps it, where the file has no texture coordinates."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "body.ply"
        trimesh.Trimesh(body.positions, body.triangles, process=False).export(path)
        return load_mesh(path, tiles=(REPEATS, REPEATS))
