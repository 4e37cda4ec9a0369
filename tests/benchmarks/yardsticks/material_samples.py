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

from processing.materials.measurements import Measurements, btf_measurements, sphere_measurements
from processing.products import Btf, ReflectanceMaps
from simulators.far_field import btf_below
from simulators.layout import direction
from simulators.light import ELECTRONS_PER_RADIANCE
from simulators.sphere_truth import camera_axes, reflectance_maps

Array = NDArray[Any]

SPHERES = {"stone": "sphere", "glaze": "sphere-glaze", "wax": "sphere-wax", "cloth": "sphere-cloth"}
# The plane of a BTF's texels under the holder's: where the texels of another seed's BTF vary least over the views,
# among steps of 0.25 mm. On the holder's own plane all surfaces lie below their texels and shift with the view.
DEPTHS_M = {"brick": 1.0e-3, "weave": 1.0e-3, "peanut": 1.25e-3, "grass": 1.25e-3}
SPHERE_RADIUS_M = 0.050
EXPOSURES_S = np.geomspace(1 / 30, 2.0, 5)
FULL_WELL_E, READ_NOISE_E = 15356.0, 4.0


@dataclass(frozen=True, eq=False)
class Samples:
    """A material by direction and texel: `true` values and `measured` ones (direction, texel, 3), 1/sr.

    `light` and `view` are unit vectors (direction or 1, texel or 1, 3) in the tangent frame; `shape` the rows and
    columns of the texels; `source` what the measured values came in, `place` (direction,) where in a BTF's pairs. NaN
    where the light does not reach. `held` are the directions that a fit is not shown when it is asked for others than
    it has seen.
    """

    name: str
    true: Array
    measured: Array
    light: Array
    view: Array
    shape: tuple[int, int]
    source: ReflectanceMaps | Btf
    place: Array
    held: Array

    @property
    def measurements(self) -> Measurements:
        """The measured samples in the form that fits take."""
        if isinstance(self.source, ReflectanceMaps):
            return sphere_measurements(self.source)
        return btf_measurements(self.source, np.arange(self.shape[0] * self.shape[1])).directions(self.place)

    def only(self, wanted: Array) -> "Samples":
        """The samples of some directions (direction,), a mask."""
        light, view = (ways if len(ways) == 1 else ways[wanted] for ways in (self.light, self.view))
        place = self.place[wanted]
        source = _pairs(self.source, place) if isinstance(self.source, Btf) else _lights(self.source, wanted)
        return replace(
            self, true=self.true[wanted], measured=self.measured[wanted], light=light, view=view, source=source,
            place=place, held=self.held[wanted],
        )  # fmt: skip


def _pairs(btf: Btf, place: Array) -> Btf:
    """The axes stay, the values of all other pairs go."""
    kept = np.isin(np.arange(btf.shape[0] * btf.shape[1]), place).reshape(btf.shape[0], btf.shape[1], 1, 1, 1)
    return replace(btf, reflectance=np.where(kept, btf.reflectance, np.float32(np.nan)))


def _lights(maps: ReflectanceMaps, wanted: Array) -> ReflectanceMaps:
    return replace(
        maps,
        reflectance_cos=maps.reflectance_cos[wanted],
        variance=maps.variance[wanted],
        light_directions=maps.light_directions[wanted],
        light_distances=maps.light_distances[wanted],
    )


def arm_sphere(material: str, size: int, seed: int) -> Samples:
    """A sphere under the twelve places of the LED arm, 0.6 m away; every third light is held out."""
    azimuths = [*range(-60, 0, 10), *range(10, 70, 10)]
    lights_m = np.stack([0.6 * direction(np.radians(azimuth), 0.0) for azimuth in azimuths])
    return _sphere((material, "arm"), lights_m, 1.1 * direction(0.0, 0.0), size, seed)


def dome_sphere(material: str, size: int, seed: int) -> Samples:
    """A sphere seen from above under 48 places of four lamps of the light arc, 0.9 m away; every third is held out."""
    places = [(elevation, azimuth) for elevation in (20, 40, 60, 80) for azimuth in range(15, 360, 30)]
    lights_m = np.stack([0.9 * direction(np.radians(azimuth), np.radians(elevation)) for elevation, azimuth in places])
    return _sphere((material, "dome"), lights_m, 1.0 * direction(0.0, np.radians(88.0)), size, seed)


def _sphere(name: tuple[str, str], lights_m: Array, eye_m: Array, size: int, seed: int) -> Samples:
    true = reflectance_maps(SPHERES[name[0]], seed, lights_m, eye_m, size).astype(np.float64)
    noisy, variance = photographed(true, np.random.default_rng((seed, len(lights_m))))
    distance_m = np.linalg.norm(lights_m, axis=1)
    maps = ReflectanceMaps(
        noisy.astype(np.float32),
        variance.astype(np.float32),
        lights_m / distance_m[:, None] @ camera_axes(eye_m),
        distance_m / SPHERE_RADIUS_M,
        float(np.linalg.norm(eye_m)) / SPHERE_RADIUS_M,
    )
    found = sphere_measurements(maps)
    values = (_lit(some.reshape(len(true), -1, 3), found.light) for some in (true, noisy))
    held = np.arange(len(true)) % 3 == 1
    return Samples("\n".join(name), *values, found.light, found.view, (size, size), maps, np.arange(len(true)), held)


def far_btf(sample: str, texels: int, rays: int, every: int, seed: int) -> Samples:
    """One period of a sample for every n-th of the 81 directions; a random half of the pairs is held out."""
    lights, views = bonn_directions()[::every], bonn_directions()[1::every]
    reflectance = btf_below(sample, seed, (lights, views), texels, rays, DEPTHS_M[sample])
    cosine = lights[:, 2][:, None, None, None, None]
    rng = np.random.default_rng((seed, texels))
    noisy, _ = photographed(reflectance * cosine, rng)
    btf = Btf((noisy / cosine).astype(np.float32), lights, views)
    light, view = np.repeat(lights, len(views), axis=0)[:, None], np.tile(views, (len(lights), 1))[:, None]
    values = (some.reshape(len(light), -1, 3) for some in ((reflectance * cosine).astype(np.float32), noisy))
    held = rng.permutation(len(light)) < len(light) // 2
    return Samples(sample, *values, light, view, (texels, texels), btf, np.arange(len(light)), held)


def bonn_directions() -> Array:
    """81 directions (81, 3), those of the BTFs of the University of Bonn (Sattler, Sarlette and Klein 2003)."""
    return rings(((0, 1), (15, 6), (30, 12), (45, 18), (60, 20), (75, 24)))


def rings(polar_deg_and_count: Sequence[tuple[float, int]]) -> Array:
    """Unit vectors (n, 3): so many, evenly spread, at each polar angle."""
    return np.stack([
        direction(2 * np.pi * step / count, np.radians(90.0 - polar))
        for polar, count in polar_deg_and_count for step in range(count)
    ])  # fmt: skip


def photographed(true: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Values as a merged bracket has them, and their variances as it says them."""
    drawn = true + rng.normal(size=true.shape) * np.sqrt(_variance(true))
    return drawn, _variance(drawn)


def _variance(value: Array) -> Array:
    electrons_per_s = np.maximum(value, 0.0) * ELECTRONS_PER_RADIANCE
    time_s, frames = np.zeros(value.shape), np.zeros(value.shape)
    for number, exposure_s in enumerate(EXPOSURES_S):
        unclipped = electrons_per_s * exposure_s < FULL_WELL_E if number else np.ones(value.shape, bool)
        time_s += exposure_s * unclipped
        frames += unclipped
    electrons = electrons_per_s * time_s + READ_NOISE_E**2 * frames
    return np.asarray(electrons / (time_s * ELECTRONS_PER_RADIANCE) ** 2)


def _lit(values: Array, light: Array) -> Array:
    return np.where(light[..., 2:] > 0, values, np.nan)
