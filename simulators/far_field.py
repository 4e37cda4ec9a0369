"""Reflectance of the periodic samples for distant lights and views, one period of each without its holder, by rays."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache

import numpy as np

from simulators.layout import Array, HolderLayout
from simulators.light import radiance
from simulators.samples.brick import brick_relief
from simulators.samples.grass import grass_mesh
from simulators.samples.mesh import Mesh, MeshSample
from simulators.samples.peanut import peanut_mesh
from simulators.samples.pipe import pipe_mesh
from simulators.samples.relief import Relief, ReliefSample
from simulators.samples.weave import weave_mesh
from simulators.scene import Floats, Hits, Mask, Sample

# 80.8 deg: on a way down to the samples' depth of 4 mm a ray goes 25 mm aside. Half a period more of the sample lies
# around the period that is looked at.
LOWEST_COSINE = 0.16
FAR_M = 1e6  # of lights and views, against which the sample is a point to 1e-7


def _bodies(mesh: Callable[[HolderLayout, int], Mesh]) -> Callable[[int], tuple[Sample, float]]:
    """Builds the bodies of one period and half a one around it, and says the period."""

    def build(seed: int) -> tuple[Sample, float]:
        holder = HolderLayout()
        period_m = holder.opening_m - 2 * holder.margin_m
        return MeshSample(mesh(replace(holder, opening_m=2 * period_m, margin_m=period_m / 2), seed)), period_m

    return build


def _brick(seed: int) -> tuple[Sample, float]:
    """One period of brick and half a one around it, and the period."""
    period_m = HolderLayout().opening_m
    brick = brick_relief(period_m, seed)
    half = len(brick.height_m) // 2

    def around(field: Array) -> Array:
        return np.pad(field, [(half, half), (half, half)] + [(0, 0)] * (field.ndim - 2), mode="wrap")

    fields = (around(field) for field in (brick.height_m, brick.albedo, brick.specular, brick.roughness))
    return ReliefSample(Relief(2 * period_m, *fields)), period_m


SAMPLES: Mapping[str, Callable[[int], tuple[Sample, float]]] = {
    "brick": _brick,
    "weave": _bodies(weave_mesh),
    "peanut": _bodies(peanut_mesh),
    "grass": _bodies(grass_mesh),
    "pipe": _bodies(pipe_mesh),
}


def btf(sample: str, seed: int, lights: Array, views: Array, texels: int, rays_per_texel: int = 1) -> Floats:
    """`btf_below` with the texels on the plane z = 0, that of the holder's opening."""
    return btf_below(sample, seed, (lights, views), texels, rays_per_texel, 0.0)


def btf_below(
    sample: str, seed: int, directions: tuple[Array, Array], texels: int, rays_per_texel: int, depth_m: float
) -> Floats:
    """Noise-free BTF (n, m, texels, texels, 3) of one period, 1/sr, no cosine; the same bits for the same arguments.

    Lights (n, 3) and views (m, 3) are unit vectors away from the sample, at most 80 deg from its normal (0, 0, 1). A
    texel is where the view's ray crosses the plane z = -depth_m, row 0 at the highest y: what lies in that plane stays
    in its texel, all else shifts with the view. A value is the mean over rays spread by the R2 sequence (Roberts 2018),
    one through the texel's middle: radiance over the light's irradiance on a level plane, shadows inside, single
    scattering. Raises ValueError for another sample and lower directions.
    """
    body, period_m = one_period(sample, seed, directions)
    places = ray_places(texels, rays_per_texel, period_m)
    lights, views = directions
    out = np.empty((len(lights), len(views), texels, texels, 3), np.float32)
    for v, view in enumerate(views):
        hits = first_hits((body, period_m), places, view, depth_m)
        for n, light in enumerate(lights):
            seen = np.zeros((len(places), 3), np.float32)
            seen[hits.ray] = reflected(hits, lit(body, hits, light), light, view)
            out[n, v] = seen.reshape(texels, texels, rays_per_texel, 3).mean(axis=2)
    return out


def one_period(sample: str, seed: int, directions: tuple[Array, Array]) -> tuple[Sample, float]:
    """The sample with half a period around the middle one, and the period in metres.

    Raises ValueError for another sample and for lights or views (n, 3) that are too low.
    """
    if sample not in SAMPLES:
        raise ValueError(f"{sample!r} is not periodic: one of {', '.join(SAMPLES)}")
    if min(ways[:, 2].min() for ways in directions) < LOWEST_COSINE:
        raise ValueError(f"a light or view is lower than 80 deg from the normal: z is under {LOWEST_COSINE}")
    return _built(sample, seed)


@lru_cache(maxsize=len(SAMPLES))
def _built(sample: str, seed: int) -> tuple[Sample, float]:
    return SAMPLES[sample](seed)


def first_hits(sample: tuple[Sample, float], places: Array, view: Array, depth_m: float) -> Hits:
    """What a view (3,) sees in places (n, 3) of the plane z = 0, which stand for those depth_m under them.

    The points lie in the middle period.
    """
    body, period_m = sample
    starts = _above(places, view, depth_m, period_m)
    hits = body.trace(starts, np.broadcast_to(-view * period_m, starts.shape))
    hits.points[:, :2] -= period_m * np.round(hits.points[:, :2] / period_m)  # there the same is seen
    return hits


def lit(body: Sample, hits: Hits, light: Array) -> Mask:
    """Which hits (n,) face a distant light (3,) and are reached by it."""
    starts = hits.points + body.offset_m * hits.normals
    visible: Mask = hits.normals @ light > 0
    ways = -starts[visible, 2:] / light[2] * light  # nothing stands above z = 0
    visible[visible] = ~body.blocks(starts[visible], ways)
    return visible


def reflected(hits: Hits, visible: Mask, light: Array, view: Array) -> Floats:
    """Reflectance (n, 3) toward the view, 1/sr of the reference plane: 0 where not `visible`."""
    return radiance(hits, visible, FAR_M * light, FAR_M * view, FAR_M) / np.float32(light[2])


def _above(places: Array, view: Array, depth_m: float, period_m: float) -> Array:
    """Where the rays to points that lie depth_m under `places` cross z = 0, within the middle period."""
    if depth_m == 0.0:
        return places
    starts: Array = places + np.append(view[:2] / view[2] * depth_m, 0.0)
    starts[:, :2] = (starts[:, :2] + period_m / 2) % period_m - period_m / 2
    return starts


def ray_places(texels: int, rays: int, period_m: float) -> Array:
    """Points (texels^2 * rays, 3) of the plane z = 0, texel by texel, the first of each in its middle."""
    golden = 1.32471795724474602596  # the root of x^3 = x + 1
    inside = (0.5 + np.arange(rays)[:, None] / golden ** np.array([1, 2])) % 1
    row, column, ray = np.meshgrid(np.arange(texels), np.arange(texels), np.arange(rays), indexing="ij")
    x = ((column + inside[ray, 0]) / texels - 0.5) * period_m
    y = (0.5 - (row + inside[ray, 1]) / texels) * period_m
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
