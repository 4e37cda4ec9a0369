"""Mitsuba 3 as referee of direct summation and of relit radiance: the same triangles and light, a tracer of its own.

Vertices of a teapot and its floor that the eye sees, under windows, light straight from the environment alone. Rows say
how far the mean of the radiances is from Mitsuba's, and the root mean square, median and 95th percentile of the
differences over that mean; `noise` is what differs between two of Mitsuba's own estimates, over the root of two.
Reflectances are diffuse, and facets that reflect all light: Mitsuba's hide each other by another formula than ours, so
that direct summation is done with either. `referee_mean_difference` is that of direct summation with the same formula,
the worst of bodies and reflectances. Without Mitsuba there is a row that says so.
"""

import importlib.util

import numpy as np

from processing.lighting.brdfs import ggx
from processing.lighting.directions import sample_directions
from processing.lighting.precomputation import TOLERANCE
from processing.lighting.shells import ShellPlan
from processing.products.arrays import Float64
from service.bench import Result
from tests.benchmarks.yardsticks.mitsuba_relit import (
    MirrorFacets,
    Painted,
    diffuse,
    facing,
    mirror_facets,
    radiance_at,
)
from tests.benchmarks.yardsticks.relit_furniture import windows
from tests.benchmarks.yardsticks.teapot_scene import EYE, WHITE, TeapotScene, teapot_scene

SEED = 1
ROUGHNESS = 0.5
SPHERES = 32
NAMES = "teapot", "floor"

Row = dict[str, object]


def run(*, quick: bool) -> Result:
    """Of 300 vertices of each body, or of 40 and with fewer of Mitsuba's samples."""
    if importlib.util.find_spec("mitsuba") is None:
        return Result({}, [{"method": "Mitsuba 3", "missing": "mitsuba is not installed"}])
    scene, sampled = teapot_scene(1.0, 60), sample_directions()
    drawn = _drawn(scene, 40 if quick else 300)
    field = scene.field(np.concatenate(drawn), sampled, ShellPlan(SPHERES))
    bodies = scene.relit(scene.cuts(np.concatenate(drawn), sampled, TOLERANCE), field)
    facets = ggx(np.zeros(3), np.ones(3), ROUGHNESS)
    kinds = (
        ("diffuse", diffuse(np.full(3, 0.7)), WHITE, WHITE),
        ("facets", mirror_facets(ROUGHNESS), MirrorFacets(ROUGHNESS), facets),
    )
    rows: list[Row] = []
    for material, theirs, same, ours in kinds:
        judged = [_judged(scene, k, drawn[k], theirs, 1024 if quick else 4096) for k in range(2)]
        relit = scene.relighting(bodies, sampled, windows(), (ours, ours))
        for k, vertices in enumerate(drawn):
            methods = {"direct summation": scene.direct(vertices, sampled, windows(), (same, same))}
            if ours is not same:
                methods["direct summation, our shadowing"] = scene.direct(vertices, sampled, windows(), (ours, ours))
            methods[f"relit, {SPHERES} spheres"] = relit.frame(vertices).radiance
            named: Row = {"material": material, "body": NAMES[k], "vertices": len(vertices)}
            rows += [{"method": name, **named, **_differences(found, judged[k])} for name, found in methods.items()]
    worst = max(abs(float(str(row["mean_difference"]))) for row in rows if row["method"] == "direct summation")
    return Result({"referee_mean_difference": worst}, rows)


def _drawn(scene: TeapotScene, count: int) -> list[np.ndarray]:
    """Vertices of each body, numbered through both, that face the eye."""
    rng, found = np.random.default_rng(SEED), []
    for number, (body, first) in enumerate(zip(scene.bodies, scene.first, strict=False)):
        seen = facing(Painted(body, scene.poses[number][:3, 3], {}), EYE)
        found.append(first + np.sort(rng.choice(seen, min(count, len(seen)), replace=False)))
    return found


def _judged(
    scene: TeapotScene, number: int, vertices: np.ndarray, reflectance: dict[str, object], samples: int
) -> Float64:
    pieces = [Painted(body, pose[:3, 3], reflectance) for body, pose in zip(scene.bodies, scene.poses, strict=True)]
    return radiance_at(pieces, number, vertices - scene.first[number], windows(), EYE, samples)


def _differences(found: Float64, judged: Float64) -> Row:
    truth = judged.mean(axis=0)
    mean, apart = truth.mean(), np.abs(found - truth).mean(axis=1)
    return {
        "mean_difference": float((found - truth).mean() / mean),
        "rms": float(np.sqrt(np.square(found - truth).mean()) / mean),
        "median": float(np.median(apart) / mean),
        "p95": float(np.percentile(apart, 95) / mean),
        "noise": float(np.sqrt(np.square(judged[0] - judged[1]).mean() / 2) / mean),
    }
