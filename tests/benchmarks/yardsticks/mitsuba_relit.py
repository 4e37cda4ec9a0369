"""Mitsuba 3 as referee of relit radiance: the same triangles and light in another tracer, sampler and shading.

Only light that comes straight from the environment counts, as in relighting. Two of Mitsuba's reflectances are ours:
its diffuse one, and its rough conductor that reflects everything, but for the facets' shadows: Walter's product of two
terms there, height-correlated here (a few percent more at grazing ways).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.lighting.brdfs import ggx
from processing.lighting.triangle_body import TriangleBody
from processing.products.arrays import Float64
from processing.products.light_environment import Environment, cube_places

Array = NDArray[Any]

VARIANT = "scalar_rgb"
_ROWS = 513  # of the panorama: a third of a degree
_PARTS = 2  # of a pixel along each side, whose mean it is
_OFF = 1e-4  # of the body's radius: how far off their vertices the patches are, as the origins of our rays
_PATCH = 1e-4  # of the radius: size of a patch
_AWAY = 1e-3  # of the radius: how far before a patch its ray begins
_LOWEST = 0.15  # cosine of the eye over a patch that is asked


@dataclass(frozen=True, eq=False)
class Painted:
    """A body where it stands, moved and not turned, with a reflectance as Mitsuba describes it."""

    body: TriangleBody
    place: Float64
    reflectance: dict[str, Any]


def diffuse(albedo: Float64) -> dict[str, Any]:
    """That of `lambert`."""
    return {"type": "diffuse", "reflectance": _rgb(albedo)}


def mirror_facets(roughness: float) -> dict[str, Any]:
    """That of `MirrorFacets`, and of `ggx` with a normal reflectance of 1 but for its shadowing."""
    return {"type": "roughconductor", "material": "none", "distribution": "ggx", "alpha": roughness**2}


class MirrorFacets:
    """`ggx` with a normal reflectance of 1 and the product of Smith's two terms (Walter et al. 2007, eq. 23 and 34)."""

    def __init__(self, roughness: float) -> None:
        self._square = roughness**4
        self._ggx = ggx(np.zeros(3), np.ones(3), roughness)

    def evaluate(self, light: Float64, view: Float64) -> Float64:
        """f (n, 3) for directions (n, 3)."""
        one, two = (self._slope_term(way[:, 2]) for way in (light, view))
        correlated, apart = 2 / (one + two), 4 / ((1 + one) * (1 + two))
        return np.asarray(self._ggx.evaluate(light, view) * (apart / correlated)[:, None])

    def _slope_term(self, cosine: Float64) -> Float64:
        """1 + 2 Lambda: the root of 1 + alpha^2 tan^2."""
        return np.asarray(np.sqrt(1 + self._square * (1 / np.square(cosine) - 1)))


def facing(piece: Painted, eye: Float64) -> Array:
    """Vertices (n,) above whose horizon the eye is."""
    toward = _unit(eye - piece.body.vertices - piece.place)
    return np.flatnonzero(np.einsum("ni,ni->n", piece.body.normals, toward) > _LOWEST)


def radiance_at(
    pieces: Sequence[Painted], number: int, vertices: Array, environment: Environment, eye: Float64, samples: int
) -> Float64:
    """Radiance (2, n, 3) toward the eye of vertices of one piece, found twice; raises ImportError without mitsuba.

    Each vertex is a tiny triangle of its own, across its normal: on those of the body, normals turn from vertex to
    vertex, and light from under a facet's own horizon is blocked.
    """
    import mitsuba as mi  # type: ignore[import-not-found, unused-ignore]

    mi.set_variant(VARIANT)
    patches = _patches(pieces[number], vertices)
    middles = patches.body.vertices.reshape(-1, 3, 3).mean(axis=1) + patches.place
    toward = _unit(eye - middles)
    meters = {
        f"ray_{i:06}": {"type": "radiancemeter", "origin": o.tolist(), "direction": d.tolist(), "film": _film(1)}
        for i, (o, d) in enumerate(zip(middles + _AWAY * pieces[number].body.radius * toward, -toward, strict=True))
    }
    sampler = {"type": "multijitter", "sample_count": samples}
    scene = {
        "type": "scene",
        "integrator": {"type": "direct", "hide_emitters": True},
        "sensor": {"type": "batch", "film": _film(len(vertices)), "sampler": sampler, **meters},
        "light": {"type": "envmap", "bitmap": mi.Bitmap(panorama(environment))},
    }
    scene |= {f"piece_{k}": _mesh(mi, piece) for k, piece in enumerate([*pieces, patches])}
    loaded = mi.load_dict(scene)
    return np.array([np.array(mi.render(loaded, seed=seed), np.float64)[0, :, :3] for seed in (0, 1)])


@lru_cache(maxsize=2)
def panorama(environment: Environment, rows: int = _ROWS) -> NDArray[np.float32]:
    """The environment (rows, 2 rows, 3) as Mitsuba has it, with all of its light.

    The first row is +Y, the last -Y; columns run from -Z toward +X.
    """
    part = (np.arange(_PARTS) + 0.5) / _PARTS - 0.5
    polar = np.clip(np.pi * (np.arange(rows)[:, None] + part).ravel() / (rows - 1), 0, np.pi)
    turn = np.pi * (np.arange(2 * rows)[:, None] + 0.5 + part).ravel() / rows
    texels = environment.radiance.reshape(-1, 3)
    found = np.empty((rows, 2 * rows, 3), np.float32)
    for row in range(rows):
        sine, cosine = (f(polar[row * _PARTS : (row + 1) * _PARTS, None]) for f in (np.sin, np.cos))
        toward = np.stack(np.broadcast_arrays(sine * np.sin(turn), cosine, -sine * np.cos(turn)), axis=-1)
        face, place = cube_places(toward.reshape(-1, 3), environment.size)
        column, line = np.clip(np.rint(place), 0, environment.size - 1).astype(np.intp).T
        values = texels[(face * environment.size + line) * environment.size + column]
        found[row] = values.reshape(_PARTS, 2 * rows, _PARTS, 3).mean(axis=(0, 2))
    level = np.sin(np.pi * np.arange(rows) / (rows - 1))
    light = 4 * np.pi * np.einsum("r,rcx->x", level / level.sum(), found.astype(np.float64)) / (2 * rows)
    return found * np.asarray(environment.integral / np.maximum(light, 1e-300), np.float32)


def _patches(piece: Painted, vertices: Array) -> Painted:
    """A tiny triangle off each vertex (n,), across its normal."""
    body, normals = piece.body, piece.body.normals[vertices]
    along = _unit(np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)]))
    across = np.cross(normals, along)
    angles = 2 * np.pi * np.arange(3)[:, None, None] / 3
    rim = np.swapaxes(np.cos(angles) * along + np.sin(angles) * across, 0, 1)
    corners = body.vertices[vertices, None] + body.radius * (_OFF * normals[:, None] + _PATCH * rim)
    triangles = np.arange(3 * len(vertices), dtype=np.int32).reshape(-1, 3)
    patches = TriangleBody(corners.reshape(-1, 3), np.repeat(normals, 3, axis=0), triangles)
    return Painted(patches, piece.place, piece.reflectance)


def _unit(rows: Float64) -> Float64:
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))


def _film(width: int) -> dict[str, Any]:
    return {"type": "hdrfilm", "width": width, "height": 1, "rfilter": {"type": "box"}, "pixel_format": "rgb"}


def _sampler(samples: int) -> dict[str, Any]:
    return {"type": "multijitter", "sample_count": samples}


def _rgb(value: Float64) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(channel) for channel in value]}


def _mesh(mi: Any, piece: Painted) -> Any:
    body = piece.body
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(piece.reflectance)
    mesh = mi.Mesh("piece", len(body.vertices), len(body.triangles), has_vertex_normals=True, props=properties)
    content = mi.traverse(mesh)
    content["vertex_positions"] = (body.vertices + piece.place).astype(np.float32).ravel()
    content["vertex_normals"] = body.normals.astype(np.float32).ravel()
    content["faces"] = body.triangles.astype(np.uint32).ravel()
    content.update()
    return mesh
