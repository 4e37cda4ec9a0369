"""Materials by formula, rough enough to show an error of a texel, a frame or a direction."""

from dataclasses import replace
from typing import Any

import numpy as np
from scipy import ndimage
from scipy.special import ndtr

from processing.products import BlinnPhong, DirectionMesh, FactoredBtf, LafortuneTexels, SbrdfPlus, Srf
from render.environment import Environment
from render.flat import FlatTexture


def hemisphere() -> np.ndarray:
    """25 directions (n, 3): the pole and three rings, the lowest at 10 degrees elevation."""
    rings = [(0.0, 1), (30.0, 6), (60.0, 8), (80.0, 10)]
    polar = np.radians(np.concatenate([np.full(count, angle) for angle, count in rings]))
    azimuth = np.concatenate([2 * np.pi * np.arange(count) / count for _, count in rings])
    return np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=1)


def periodic_height(height: int, width: int, seed: int = 1) -> np.ndarray:
    """A smooth random surface (height, width) that repeats, standard deviation 1."""
    rng = np.random.default_rng(seed)
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(width) * width, np.fft.fftfreq(height) * height))
    amplitude = np.where((frequency >= 2) & (frequency <= 14), np.maximum(frequency, 1.0) ** -1.5, 0.0)
    surface = np.fft.ifft2(amplitude * np.exp(2j * np.pi * rng.random((height, width)))).real
    return surface / surface.std()


def stone(height: int = 64, width: int = 64, *, exponent: float = 40.0, wrap: bool = True) -> Srf:
    """Phong with a residual that tilts like a bump map and varies in colour."""
    surface = periodic_height(height, width)
    slope_u = np.roll(surface, -1, axis=1) - surface
    slope_v = np.roll(surface, -1, axis=0) - surface
    diffuse = np.array([0.10, 0.07, 0.05])
    tint = diffuse * (1 + 0.3 * periodic_height(height, width, seed=2)[:, :, None])
    residual = np.stack([-slope_u[..., None] * diffuse, slope_v[..., None] * diffuse, tint - diffuse], axis=-1)
    lobe = BlinnPhong(diffuse, np.array([0.12, 0.11, 0.10]), exponent)
    return Srf(np.moveaxis(residual, 2, 0).astype(np.float32), lobe, wrap)


def bricks(texels: int = 32, rank: int = 4) -> FactoredBtf:
    """A BTF of bumpy, shadowless bricks, factorised by a small singular value decomposition."""
    directions = hemisphere()
    surface = periodic_height(texels, texels)
    slope_u, slope_v = (np.gradient(surface, axis=axis) for axis in (1, 0))
    normal = np.stack([-0.4 * slope_u, 0.4 * slope_v, np.ones_like(surface)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    colour = np.array([0.4, 0.2, 0.12]) * (1 + 0.2 * periodic_height(texels, texels, seed=3)[:, :, None])
    lit = (
        np.maximum(np.einsum("yxi,li->lyx", normal, directions), 0.0) / np.maximum(directions[:, 2], 0.2)[:, None, None]
    )
    half = directions[:, None] + directions
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    gloss = 0.2 * np.maximum(np.einsum("yxi,lvi->lvyx", normal, half), 0.0) ** 20
    btf = lit[:, None, :, :, None] * colour / np.pi + gloss[..., None]
    return factored(btf, directions, rank)


def factored(btf: np.ndarray, directions: np.ndarray, rank: int) -> FactoredBtf:
    """The first `rank` terms of a BTF (light, view, y, x, channel) over the same light and view directions."""
    columns = np.moveaxis(btf, 1, -1)
    u, s, vt = np.linalg.svd(columns.reshape(-1, columns.shape[-1]), full_matrices=False)
    maps = (u[:, :rank] * s[:rank]).reshape(*columns.shape[:-1], rank)
    mesh = DirectionMesh.from_directions(directions)
    return FactoredBtf(np.moveaxis(maps, -1, 0).astype(np.float32), vt[:rank].astype(np.float32), mesh, mesh)


def pattern(texels: int) -> FlatTexture:
    """A coloured texture that repeats."""
    layers = [0.5 + 0.15 * periodic_height(texels, texels, seed=seed) for seed in (4, 5, 6)]
    return FlatTexture(np.clip(np.stack(layers, axis=-1), 0.0, 1.0).astype(np.float32))


def lambertian(albedo: tuple[float, float, float]) -> FactoredBtf:
    """A matt BTF: albedo / pi for every light and view."""
    directions = hemisphere()
    value = np.broadcast_to(np.array(albedo) / np.pi, (len(directions), len(directions), 2, 2, 3))
    return factored(value, directions, rank=1)


def daylight(height: int = 32, *, azimuth_rad: float = 0.0) -> Environment:
    """A sky that pales toward the horizon, brown ground, and a sun of 6 deg at azimuth 80 and elevation 40 deg.

    The sun sheds about half of all light.
    """
    dark = Environment(np.zeros((height, 2 * height, 3), np.float32), azimuth_rad)
    up = dark.directions[..., 2:]
    sun = direction_rad(np.radians(80.0), np.radians(40.0))
    near = np.exp(-0.5 * (np.arccos(np.clip(dark.directions @ sun, -1, 1)) / np.radians(6.0)) ** 2)[..., None]
    sky = np.array([0.3, 0.5, 1.0]) + np.array([0.7, 0.5, 0.2]) * (1.0 - np.clip(up, 0, 1)) ** 4
    radiance = np.where(up > 0, sky, np.array([0.12, 0.09, 0.06])) + 60.0 * near * np.array([1.0, 0.9, 0.7])
    return Environment(radiance.astype(np.float32), azimuth_rad)


def direction_rad(azimuth_rad: float, elevation_rad: float) -> np.ndarray:
    """Unit vector (3,) at an azimuth from +X toward +Y and an elevation."""
    level = np.cos(elevation_rad)
    return np.array([level * np.cos(azimuth_rad), level * np.sin(azimuth_rad), np.sin(elevation_rad)])


def levelled(shape: tuple[int, int] = (24, 20), **kind: Any) -> SbrdfPlus:
    """The same with coarser levels down to one texel, which have nothing to do with each other: a wrong one shows."""
    sides = [shape]
    while max(sides[-1]) > 1:
        sides.append((max(sides[-1][0] // 2, 1), max(sides[-1][1] // 2, 1)))
    finest, *coarser = (weave(side, seed=seed, **kind) for seed, side in enumerate(sides))
    return replace(finest, coarser=tuple(coarser))


def weave(
    shape: tuple[int, int] = (24, 20),
    *,
    lobes: int = 3,
    hidden: float = 0.3,
    centres: int = 40,
    largest_exponent: float = 60.0,
    seed: int = 1,
    directions: np.ndarray | None = None,
) -> SbrdfPlus:
    """An SBRDF+ of no physics: smooth lobes, shadows and shifts of some texels, a share of hidden points.

    Shifts are in steps of an eighth of a texel, as those of a packed product are.
    """
    rng = np.random.default_rng(seed)
    mesh = DirectionMesh.from_directions(hemisphere() if directions is None else directions)
    count = len(mesh.directions)

    def smooth(low, high, *more):
        maps = rng.normal(size=(*more, *shape))
        maps = ndimage.gaussian_filter(maps, (0,) * len(more) + (1.5, 1.5), mode="wrap")
        spread = np.sqrt(np.mean(maps**2)) if maps.size else 1.0
        return (low + (high - low) * ndtr(maps / spread)).astype(np.float32)

    axis = np.moveaxis(smooth(-1.0, 1.0, lobes, 3), (0, 1), (2, 3))
    axis[..., 2] = np.abs(axis[..., 2]) + 0.3
    axis /= np.abs(axis).max(axis=-1, keepdims=True, initial=1e-9)
    here = smooth(0.0, 1.0, count) < hidden
    return SbrdfPlus(
        LafortuneTexels(
            np.moveaxis(smooth(0.02, 0.2, 3), 0, 2),
            axis,
            np.moveaxis(np.exp(smooth(0.0, np.log(largest_exponent), lobes)), 0, 2),
            np.moveaxis(smooth(0.0, 0.4, lobes, 3), (0, 1), (2, 3)),
        ),
        smooth(0.0, 1.0, count),
        np.rint(8.0 * np.moveaxis(smooth(-4.0, 4.0, count, 2), 1, 3)) / 8.0,
        here & (centres > 0),
        rng.integers(0, max(centres, 1), (count, *shape)).astype(np.uint16),
        rng.uniform(0.0, 0.2, (centres, count, 3)).astype(np.float32),
        mesh,
        mesh,
    )
