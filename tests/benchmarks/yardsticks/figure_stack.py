"""The simulated figure under lamps, seen straight from above without lens, as a stack of pictures with sensor noise."""

from dataclasses import dataclass

import numpy as np

from processing.products import LightStack, plane_points
from simulators.light import radiance
from simulators.samples.figure import RADIUS_M, figure_mesh
from simulators.samples.mesh import MeshSample

FAR_M = 1e4
WHITE_E, READ_E = 10_000.0, 4.0  # electrons of a white surface that faces a lamp, and of the sensor without light


@dataclass(frozen=True, eq=False)
class FigureTruth:
    """Normals (y, x, 3) and height (y, x) in metres of what the pixels' middles see, NaN beside the figure."""

    normals: np.ndarray
    height_m: np.ndarray


def dome_lights(count: int, lowest_deg: float = 20.0, highest_deg: float = 75.0) -> np.ndarray:
    """Unit vectors (count, 3) on a spiral between two elevations, evenly over the height."""
    z = np.sin(np.radians(np.linspace(lowest_deg, highest_deg, count)))
    turn = np.arange(count) * np.pi * (3 - np.sqrt(5))
    return np.column_stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z])


def figure_stack(seed: int, lights: np.ndarray, distance_m: float, size: int) -> tuple[LightStack, FigureTruth]:
    """Pictures size x size under point lamps at this distance from the figure's middle, and the truth."""
    body, pixel_m = MeshSample(figure_mesh(seed)), 2.1 * RADIUS_M / size
    starts = plane_points((size, size), pixel_m).reshape(-1, 3) + np.array([0.0, 0.0, 2 * RADIUS_M])
    hits = body.trace(starts, np.tile([0.0, 0.0, -4 * RADIUS_M], (len(starts), 1)))
    eye = np.array([0.0, 0.0, FAR_M])
    value = np.full((len(lights), size * size, 3), np.nan)
    for number, light in enumerate(lights):
        ways = light * distance_m - (hits.points + body.offset_m * hits.normals)
        visible = ((ways * hits.normals).sum(axis=1) > 0) & ~body.blocks(
            hits.points + body.offset_m * hits.normals, ways
        )
        value[number, hits.ray] = radiance(hits, visible, light * distance_m, eye, distance_m)
    per_e = 0.9 / np.pi / WHITE_E
    variance = (np.maximum(value, 0) / per_e + READ_E**2) * per_e**2
    noisy = value + np.sqrt(variance) * np.random.default_rng(seed).standard_normal(value.shape)
    shape = (len(lights), size, size, 3)
    stack = LightStack(
        noisy.reshape(shape).astype(np.float32), variance.reshape(shape).astype(np.float32), lights,
        np.full(len(lights), distance_m), pixel_m,
    )  # fmt: skip
    normals, height_m = np.full((size * size, 3), np.nan), np.full(size * size, np.nan)
    normals[hits.ray], height_m[hits.ray] = hits.normals, hits.points[:, 2]
    return stack, FigureTruth(normals.reshape(size, size, 3), height_m.reshape(size, size))
