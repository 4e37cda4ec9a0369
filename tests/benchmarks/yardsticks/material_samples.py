"""Materials as the simulators have them, and as a camera would have measured them: values with the cosine inside.

The noise is that of a bracket of five exposures of the simulated camera, merged: shot noise of all the electrons that
were collected below full well, read noise of each exposure. Fits see the noisy values, errors are against the true
ones.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.products import ReflectanceMaps, sphere_normals, tangent_frames
from simulators.layout import SphereLayout, direction
from simulators.light import ELECTRONS_PER_RADIANCE, radiance
from simulators.scene_sphere import SphereScene

Array = NDArray[Any]

EXPOSURES_S = np.geomspace(1 / 30, 2.0, 5)
FULL_WELL_E, READ_NOISE_E = 15356.0, 4.0


@dataclass(frozen=True, eq=False)
class Samples:
    """A material by direction and texel: `true` values and `measured` ones (direction, texel, 3), 1/sr.

    `light` and `view` are unit vectors (direction, texel or 1, 3) in the tangent frame; `shape` the rows and columns
    of the texels; `source` what the measured values came in. Not lit: NaN.
    """

    name: str
    true: Array
    measured: Array
    light: Array
    view: Array
    shape: tuple[int, int]
    source: ReflectanceMaps

    def only(self, directions: Sequence[int] | Array) -> "Samples":
        """The samples of some directions."""
        keep = np.asarray(directions)
        maps = self.source
        part = replace(
            maps,
            reflectance_cos=maps.reflectance_cos[keep],
            variance=maps.variance[keep],
            light_directions=maps.light_directions[keep],
            light_distances=maps.light_distances[keep],
        )
        view = self.view[keep] if len(self.view) > 1 else self.view
        return replace(
            self, true=self.true[keep], measured=self.measured[keep], light=self.light[keep], view=view, source=part
        )


def sphere_samples(name: str, lights_m: Array, eye_m: Array, size: int, seed: int) -> Samples:
    """A sphere seen from one place under each light, positions (light, 3) and (3,) in the rig's frame."""
    scene = SphereScene(SphereLayout(), seed)
    forward = -eye_m / np.linalg.norm(eye_m)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    map_from_rig = np.stack([right, np.cross(forward, right), forward])
    hits = scene.normal_hits(sphere_normals(size).reshape(-1, 3) @ map_from_rig)
    true = np.stack([
        radiance(hits, scene.lit(hits, light), light, eye_m, float(np.linalg.norm(light))) for light in lights_m
    ])  # fmt: skip
    noisy, variance = photographed(true, np.random.default_rng((seed, len(lights_m))))
    radius_m = scene.layout.radius_m
    distance_m = np.linalg.norm(lights_m, axis=1)
    maps = ReflectanceMaps(
        noisy.reshape(-1, size, size, 3).astype(np.float32),
        variance.reshape(-1, size, size, 3).astype(np.float32),
        lights_m / distance_m[:, None] @ map_from_rig.T,
        distance_m / radius_m,
        float(np.linalg.norm(eye_m)) / radius_m,
    )
    frames = tangent_frames(sphere_normals(size)).reshape(-1, 3, 3)
    light = np.einsum("tij,dtj->dti", frames, maps.lights().reshape(len(true), -1, 3))
    view = np.einsum("tij,tj->ti", frames, maps.views().reshape(-1, 3))[None]
    lit = light[..., 2:] > 0
    known = [np.where(lit, values, np.nan) for values in (true, noisy)]
    return Samples(name, *known, light, view, (size, size), maps)


def arm_m(count: int = 12) -> Array:
    """Lights of the LED arm (count, 3), from -60 to 60 deg without the middle, 0.6 m away, at the camera's height."""
    half = np.linspace(60, 120 / count, count // 2)
    return np.stack([0.6 * direction(np.radians(azimuth), 0.0) for azimuth in [*-half, *half[::-1]]])


def dome_m(elevations_deg: Sequence[float], azimuths: int) -> Array:
    """Lights of the arc (elevation x azimuth, 3), 0.9 m away."""
    places = [(e, 360 / azimuths * (a + 0.5)) for e in elevations_deg for a in range(azimuths)]
    return np.stack([0.9 * direction(np.radians(azimuth), np.radians(elevation)) for elevation, azimuth in places])


def photographed(true: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Values as a merged bracket has them, and their variances as it says them."""
    drawn = true + rng.normal(size=true.shape) * np.sqrt(_variance(true))
    return drawn, _variance(drawn)


def _variance(value: Array) -> Array:
    electrons_per_s = np.maximum(value, 0.0) * ELECTRONS_PER_RADIANCE
    unclipped = electrons_per_s[..., None] * EXPOSURES_S < FULL_WELL_E
    unclipped[..., 0] = True
    time_s = unclipped @ EXPOSURES_S
    read_e2 = READ_NOISE_E**2 * unclipped.sum(axis=-1)
    return np.asarray((electrons_per_s * time_s + read_e2) / (time_s * ELECTRONS_PER_RADIANCE) ** 2)
