"""Light on surfaces and from there into the camera.

One unit of irradiance is what any lamp at full level gives a surface at the rig origin that faces it. Surfaces reflect
a Lambertian part, albedo / pi, and a glossy one: microfacets of the distribution of Trowbridge and Reitz with Smith's
shadowing and Schlick's Fresnel term. Some also scatter what has entered through that glossy surface, and have a sheen
of upright fibres, or facets of grooved metal that lie otherwise along the grooves than across (`scene.Below`,
`scene.Material`, `scene.Grain`). Reflectance is in 1/sr, radiance in units of irradiance per steradian.
"""

from math import pi

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from simulators.scene import Array, Floats, Hits, Mask

# Electrons per second and unit of radiance, green channel: a white surface (albedo 0.9) that faces a lamp gives 60 000.
# So 1/30 s collects 2000 e- from it and 2 s saturates it (15 356 e-) eightfold; the darkest ink still gives 5000 e-.
ELECTRONS_PER_RADIANCE = 60000.0 * pi / 0.9
CHANNELS = np.array([0.60, 1.00, 0.72])  # the sensor's response to white light
# Peak irradiance of the stripe at the origin for the red channel, in the same units: white facing the laser gives
# 250 000 e-/s, about 10 000 e- at 1/15 s under the slant of the mountings, 5000 e- at 1/30 s.
LASER_PEAK = 250000.0 / 60000.0
LASER_CHANNELS = np.array([1.00, 0.12, 0.03])
# Of the fibres' directions: a full sheen gives back 0.08 of the light toward a view along the normal, 0.57 at 85 deg.
SHEEN_ROUGHNESS = 0.5
# XYZ to linear sRGB primaries under D65 (IEC 61966-2-1), which sensors' channels follow up to their white balance.
SRGB_FROM_XYZ = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
AMBIENT = 3e-4  # irradiance of the stray light in the dark room


def radiance(hits: Hits, visible: Mask, source: Array, eye: Array, reach_m: float) -> Floats:
    """Radiance (n, 3) toward the eye (3,) of hits lit by a point source (3,), one unit strong at `reach_m`.

    The cosine of incidence is inside; the inverse square of the distance too. 0 where not `visible` (n,).
    """
    out = np.zeros((len(hits.points), 3), np.float32)
    material = hits.material
    surface = (hits.points, hits.normals, material.albedo, material.specular, material.roughness)
    ends = np.stack([source, eye])
    _radiance(surface, visible, ends, reach_m, out)
    if material.below is not None:
        below = (material.below.albedo, material.below.spread, material.specular)
        _add_below(surface[:2], below, visible, ends, reach_m, out)
    if material.sheen is not None:
        _add_sheen(surface[:2], material.sheen, visible, ends, reach_m, out)
    if material.grain is not None:
        grain = (material.grain.along, material.grain.roughness, material.grain.reflectance)
        _add_grain(surface[:2], grain, visible, ends, reach_m, out)
    return out


def stripe_angles(points: Array, source: Array, azimuth_rad: float) -> Array:
    """Depression angle (n,) of the fan plane that passes through each point (n, 3), source (3,) at this azimuth."""
    inward = -np.array([np.cos(azimuth_rad), np.sin(azimuth_rad)])
    angles: Array = np.arctan2(source[2] - points[:, 2], (points[:, :2] - source[:2]) @ inward)
    return angles


def stripe_profile(angles: Array, widths: Array, sweep: tuple[float, float]) -> Array:
    """Mean of the stripe's Gaussian (n,) over an exposure during which the plane turned evenly from sweep[0] to [1].

    `angles` and `widths` (n,) are each point's own fan angle and the stripe's standard deviation there, radians.
    """
    start, end = sweep
    root = np.sqrt(2.0) * widths
    if abs(end - start) < 1e-9:
        still: Array = np.exp(-(((angles - start) / root) ** 2))
        return still
    passed = erf((end - angles) / root) - erf((start - angles) / root)
    mean: Array = np.sqrt(pi / 2) * widths * passed / (end - start)
    return mean


@numba.njit(cache=True)
def _dot(a: Array, b: Array) -> float:
    product: float = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


@numba.njit(cache=True)
def _glossy(n_l: float, n_v: float, n_h: float, v_h: float, gloss: tuple[float, float]) -> float:
    """Microfacet reflectance (1/sr) of one direction pair, by its cosines."""
    specular, roughness = gloss
    square = roughness**4  # the usual reparametrisation: the lobe's width grows as roughness squared
    spread = n_h * n_h * (square - 1.0) + 1.0
    facets = square / (pi * spread * spread)
    hidden = n_l * np.sqrt(square + (1 - square) * n_v * n_v) + n_v * np.sqrt(square + (1 - square) * n_l * n_l)
    fresnel = specular + (1.0 - specular) * (1.0 - v_h) ** 5
    reflectance: float = 0.5 * facets * fresnel / hidden
    return reflectance


@numba.njit(cache=True)
def _radiance(
    surface: tuple[Array, Floats, Floats, Floats, Floats], visible: Mask, ends: Array, reach: float, out: Floats
) -> None:
    points, normals, albedo, specular, roughness = surface
    for i in range(len(points)):
        if not visible[i]:
            continue
        light, view = ends[0] - points[i], ends[1] - points[i]
        square = _dot(light, light)
        light /= np.sqrt(square)
        view /= np.sqrt(_dot(view, view))
        n_l, n_v = _dot(light, normals[i]), max(_dot(view, normals[i]), 1e-3)
        if n_l <= 0.0:
            continue
        half = light + view
        half /= np.sqrt(_dot(half, half))
        gloss = 0.0
        if specular[i] > 0.0:
            gloss = _glossy(n_l, n_v, _dot(half, normals[i]), _dot(half, view), (specular[i], roughness[i]))
        irradiance = n_l * reach * reach / square
        for k in range(3):
            out[i, k] = irradiance * (albedo[i, k] / pi + gloss)


@numba.njit(cache=True)
def _passed(cosine: float, specular: float) -> float:
    """Share of the light that goes through the glossy surface, by Schlick's Fresnel term."""
    share: float = (1.0 - specular) * (1.0 - (1.0 - min(cosine, 1.0)) ** 5)
    return share


@numba.njit(cache=True)
def _way(start: Array, end: Array) -> tuple[Array, float]:
    """Unit vector from start to end, and the distance squared."""
    way = end - start
    square = _dot(way, way)
    return way / np.sqrt(square), square


@numba.njit(cache=True)
def _add_below(
    surface: tuple[Array, Floats], below: tuple[Floats, Floats, Floats], visible: Mask, ends: Array, reach: float,
    out: Floats,
) -> None:  # fmt: skip
    """Light that enters through the surface, spreads below it and leaves.

    The cosine of incidence c is replaced by (c + s) / (1 + s)^2, s the spread: light goes past the terminator, and over
    all directions of incidence the sum is the same. Both ways through the surface cost what it reflects.
    """
    points, normals = surface
    albedo, spread, specular = below
    for i in range(len(points)):
        if not visible[i]:
            continue
        light, square = _way(points[i], ends[0])
        view, _ = _way(points[i], ends[1])
        leaving = _passed(max(_dot(view, normals[i]), 1e-3), specular[i])
        n_l = _dot(light, normals[i])
        for k in range(3):
            entering = (n_l + spread[i, k]) / (1 + spread[i, k])
            if entering > 0.0:
                share = _passed(entering, specular[i]) * leaving * entering / (1 + spread[i, k])
                out[i, k] += reach * reach / square * share * albedo[i, k] / pi


@numba.njit(cache=True)
def _add_sheen(
    surface: tuple[Array, Floats], sheen: Floats, visible: Mask, ends: Array, reach: float, out: Floats
) -> None:
    """Light that upright fibres reflect: distribution of Estevez and Kulla 2017, visibility of Neubelt and Pettineo."""
    points, normals = surface
    for i in range(len(points)):
        light, square = _way(points[i], ends[0])
        view, _ = _way(points[i], ends[1])
        n_l, n_v = _dot(light, normals[i]), max(_dot(view, normals[i]), 1e-3)
        if not visible[i] or n_l <= 0.0 or sheen[i] == 0.0:
            continue
        n_h = _dot(light + view, normals[i]) / np.sqrt(_dot(light + view, light + view))
        sine = np.sqrt(max(1.0 - n_h * n_h, 0.0))
        fibres = (2 + 1 / SHEEN_ROUGHNESS) * sine ** (1 / SHEEN_ROUGHNESS) / (2 * pi)
        gloss = sheen[i] * fibres / (4 * (n_l + n_v - n_l * n_v))
        for k in range(3):
            out[i, k] += n_l * reach * reach / square * gloss


@numba.njit(cache=True)
def _add_grain(
    surface: tuple[Array, Floats], grain: tuple[Floats, Floats, Floats], visible: Mask, ends: Array, reach: float,
    out: Floats,
) -> None:  # fmt: skip
    """Light that the facets of grooved metal reflect, with Schlick's Fresnel term in each channel."""
    points, normals = surface
    along, roughness, reflectance = grain
    for i in range(len(points)):
        light, square = _way(points[i], ends[0])
        n_l = _dot(light, normals[i])
        if not visible[i] or n_l <= 0.0 or roughness[i, 0] == 0.0:
            continue
        view, _ = _way(points[i], ends[1])
        frame = (along[i], np.cross(normals[i], along[i]), normals[i])
        facets = _drawn_out(_within(frame, light), _within(frame, view), (roughness[i, 0], roughness[i, 1]))
        half, _ = _way(-light, view)
        rest = (1.0 - _dot(half, view)) ** 5
        for k in range(3):
            fresnel = reflectance[i, k] + (1.0 - reflectance[i, k]) * rest
            out[i, k] += n_l * reach * reach / square * facets * fresnel


@numba.njit(cache=True)
def _within(frame: tuple[Array, Array, Array], way: Array) -> tuple[float, float, float]:
    """Components of a unit vector out of the surface along, across and out of it; the last at least 1e-3."""
    return _dot(way, frame[0]), _dot(way, frame[1]), max(_dot(way, frame[2]), 1e-3)


@numba.njit(cache=True)
def _drawn_out(
    light: tuple[float, float, float], view: tuple[float, float, float], roughness: tuple[float, float]
) -> float:
    """Reflectance (1/sr) of facets that are perfect mirrors, by components along, across and out of the surface.

    That of `_glossy` with a width of its own along and across: distribution of Burley 2012 (GTR of exponent 2), masking
    and shadowing of Heitz 2014, eqs. 86 and 99.
    """
    along, across = roughness[0] ** 2, roughness[1] ** 2
    x, y, z = light[0] + view[0], light[1] + view[1], light[2] + view[2]
    spread = ((x / along) ** 2 + (y / across) ** 2 + z * z) / (x * x + y * y + z * z)
    facets = 1.0 / (pi * along * across * spread * spread)
    hidden = light[2] * np.sqrt((along * view[0]) ** 2 + (across * view[1]) ** 2 + view[2] ** 2)
    hidden += view[2] * np.sqrt((along * light[0]) ** 2 + (across * light[1]) ** 2 + light[2] ** 2)
    reflectance: float = 0.5 * facets / hidden
    return reflectance


@numba.njit(cache=True)
def gather(values: Floats, ray: NDArray[np.int64], per_pixel: int, image: Floats) -> None:
    """Add the hits' values (n, 3) to an image (h, w, 3); `per_pixel` rays, numbered pixel by pixel, share a pixel."""
    width = image.shape[1]
    for i in range(len(ray)):
        pixel = ray[i] // per_pixel
        for k in range(3):
            image[pixel // width, pixel % width, k] += values[i, k] / per_pixel


@numba.njit(cache=True)
def through_filters(image: Floats, gains: Array, mosaic: Floats) -> None:
    """What the sensor's RGGB filters leave of an image (h, w, 3), each channel with its gain, in a mosaic (h, w)."""
    for row in range(mosaic.shape[0]):
        for col in range(mosaic.shape[1]):
            k = row % 2 + col % 2
            mosaic[row, col] = image[row, col, k] * gains[k]
