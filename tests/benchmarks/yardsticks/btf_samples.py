"""BTFs with their truth: ray-traced periodic samples, and planes of which everything is known.

Measured values carry the noise of a merged bracket (`material_samples.photographed`); errors are against the true ones.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.products import Btf
from simulators.far_field import btf_below
from simulators.far_field_truth import FarFieldTruth, traced, truth
from simulators.light import radiance
from simulators.scene import Hits, Material
from tests.benchmarks.yardsticks.material_samples import DEPTHS_M, photographed, rings

Array = NDArray[Any]

SAMPLES = ("brick", "weave", "peanut", "grass", "pipe")
# As `material_samples.DEPTHS_M`, found on seeds 2 and 3.
PLANES_M = DEPTHS_M | {"pipe": 2.25e-3}
_KEPT = 5  # all samples of one kind; 0.7 GB each at 64 x 64 texels and 81 x 81 directions
_FAR_M = 1e6


@dataclass(frozen=True, eq=False)
class BtfWithTruth:
    """A BTF as it would have been measured, the true one, and what is known of shadows and places."""

    name: str
    btf: Btf
    true: Btf
    truth: FarFieldTruth


def ray_traced(sample: str, texels: int, seed: int, lights: Array, views: Array, rays: int = 1) -> BtfWithTruth:
    """One period of a sample under lights (n, 3) in views (m, 3), kept for the next who asks for the same.

    With one ray to a texel values and truth are of the same point; with more the truth is of the first ray's.
    """
    return _ray_traced((sample, texels, seed, rays), _hashable(lights), _hashable(views))


def matt_plane(texels: int, lights: Array, views: Array, albedo: float = 0.5) -> BtfWithTruth:
    """A Lambertian plane without noise: no shadow, no hidden point, no shift."""
    return _plane("matt", _material(texels, (albedo, 0.0, 1.0)), lights, views)


def mirror_plane(texels: int, lights: Array, views: Array, roughness: float = 0.2) -> BtfWithTruth:
    """A dark plane whose highlight is narrower than the angles between neighbouring directions; without noise."""
    return _plane("mirror", _material(texels, (0.05, 0.6, roughness)), lights, views)


def quick_directions() -> Array:
    """19 directions (19, 3): the top, 6 at 30 deg and 12 at 60 deg."""
    return rings(((0, 1), (30, 6), (60, 12)))


def ring_of(directions: Array) -> Array:
    """Polar angle (n,) in whole degrees."""
    return np.degrees(np.arccos(np.clip(directions[:, 2], -1.0, 1.0))).round().astype(int)


@lru_cache(maxsize=_KEPT)
def _ray_traced(which: tuple[str, int, int, int], lights: tuple[Any, ...], views: tuple[Any, ...]) -> BtfWithTruth:
    sample, texels, seed, rays = which
    ways, depth_m = (np.array(lights), np.array(views)), PLANES_M[sample]
    if rays == 1:
        true, known = traced(sample, seed, ways, texels, depth_m)
    else:
        true = btf_below(sample, seed, ways, texels, rays, depth_m)
        known = truth(sample, seed, ways, texels, depth_m)
    noisy = _measured(true, ways[0], np.random.default_rng((seed, texels)))
    return BtfWithTruth(sample, Btf(noisy, *ways), Btf(true, *ways), known)


def _measured(reflectance: Array, lights: Array, rng: np.random.Generator) -> Array:
    """Values with the noise of a merged bracket, light by light: all at once takes ten times the memory."""
    noisy = np.empty_like(reflectance)
    for light, true, out in zip(lights, reflectance, noisy, strict=True):
        out[:] = photographed(true * light[2], rng)[0] / light[2]
    return noisy


def _plane(name: str, material: Material, lights: Array, views: Array) -> BtfWithTruth:
    count = len(material.specular)
    texels = round(count**0.5)
    up = np.tile(np.array([0, 0, 1], np.float32), (count, 1))
    hits = Hits(np.arange(count), np.zeros((count, 3)), up, material)
    values = np.empty((len(lights), len(views), texels, texels, 3), np.float32)
    for n, m in np.ndindex(len(lights), len(views)):
        found = radiance(hits, np.ones(count, bool), _FAR_M * lights[n], _FAR_M * views[m], _FAR_M) / lights[n, 2]
        values[n, m] = found.reshape(texels, texels, 3)
    btf, square = Btf(values, lights, views), (texels, texels)
    known = FarFieldTruth(
        np.full((len(views), *square, 3), np.nan),
        np.zeros((len(lights), len(views), *square), bool),
        np.zeros((len(views), *square), bool),
        np.zeros((len(views), *square, 2), np.float32),
    )
    return BtfWithTruth(name, btf, btf, known)


def _material(texels: int, surface: tuple[float, float, float]) -> Material:
    """Albedo, specular and roughness, the same in all texels."""
    count = texels * texels
    albedo, specular, roughness = (np.float32(value) for value in surface)
    return Material(np.full((count, 3), albedo), np.full(count, specular), np.full(count, roughness))


def _hashable(directions: Array) -> tuple[Any, ...]:
    return tuple(map(tuple, directions.tolist()))
