"""Frames of a BTF with depths: their cost over the plain BTF's, and how far OpenGL is from NumPy.

Frames of 800 x 600 of the paper's scenes under one light, drawn in turns by one renderer: the plain BTF, with
silhouettes, and with silhouettes and shadows, all of the terms in bytes that are the default of joined materials.
The light turns a little from frame to frame, so that shadow maps are drawn each time; another row has shadows under a
light at rest, whose map is kept. As in Table 2 of Wang et al. 2005, two layers are peeled; of a software
rasteriser the processor's time counts. Figures are of the worst scene. `peels_used_mean` is how many layers there are
until no face is left. `gl_vs_reference` compares what the shader makes of the points that it met with NumPy's values
there; rows have the share of pixels in which the two meet something else.
"""

import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from processing.products import Mesostructure
from render.comparison import gl_vs_reference
from render.errors import GlUnavailableError
from render.opengl import GlRenderer
from render.reference import ReferenceRenderer
from render.scene import orbiting_light
from service.bench import Result
from tests.benchmarks.btf_mdfs.accuracy import FULL, QUICK
from tests.benchmarks.yardsticks.figure_scenes import FigureScene, figure_scene

Row = dict[str, Any]
SCENES = ("two tori", "knot on floor", "torus 8 x 3", "torus 3 x 1", "cylinder", "statue")
QUICK_SCENES, QUICK_SAMPLE = ("torus 3 x 1", "statue"), "weave"
WARM = 2  # frames that compile and upload
PEELS = 2
PLAIN, SILHOUETTES, SHADOWS = "plain BTF", "with silhouettes", "with shadows too"
RESTING = "with shadows of a light at rest"
TURN_RAD = 1e-3  # of the light from frame to frame
SMALL = (160, 120)


def run(*, quick: bool) -> Result:
    """Times, layers and errors; quick of fewer scenes and frames, with one sample of few texels."""
    try:
        peeling, whole = GlRenderer(most_layers=PEELS), GlRenderer()
    except GlUnavailableError as error:
        return Result({}, [{"method": "frames", "missing": str(error)}])
    rows: list[Row] = []
    try:
        for name in QUICK_SCENES if quick else SCENES:
            figure = figure_scene(name)
            made = QUICK.of(QUICK_SAMPLE) if quick else None
            materials = {sample: made or FULL.of(sample) for sample in figure.samples}
            rows += frame_times(peeling, whole, name, figure, materials, 3 if quick else 15)
            rows.append(errors(whole, name, materials))
    finally:
        peeling.release()
        whole.release()
    figures = {
        "silhouette_over_plain_fps": min(row["fps_over_plain"] for row in rows if row.get("method") == SILHOUETTES),
        "shadows_over_plain_fps": min(row["fps_over_plain"] for row in rows if row.get("method") == SHADOWS),
        "peels_used_mean": float(np.mean([row["peels"] for row in rows if row.get("method") == SILHOUETTES])),
        "gl_vs_reference": max(row["error"] for row in rows if "error" in row),
    }
    return Result(figures, rows)


def frame_times(
    renderer: GlRenderer,
    whole: GlRenderer,
    name: str,
    figure: FigureScene,
    materials: Mapping[str, Mesostructure],
    frames: int,
) -> Iterator[Row]:
    """Medians of frames that took turns, and the plain BTF's time over them."""
    wrapped = figure.scene(materials)
    shaded = replace(wrapped, shadows=True)
    scenes = {
        PLAIN: figure.scene({sample: each.btf for sample, each in materials.items()}),
        SILHOUETTES: wrapped,
        RESTING: shaded,
        SHADOWS: shaded,
    }
    turning = orbiting_light(shaded, round(2.0 * np.pi / TURN_RAD))
    # What else runs delays long frames more than short ones; a software rasteriser's own time does not know of it.
    clock = time.process_time if "llvmpipe" in renderer.name else time.perf_counter
    spent: dict[str, list[tuple[float, float]]] = {method: [] for method in scenes}
    for _ in range(WARM + frames):
        for method, scene in scenes.items():
            if method == RESTING:
                renderer.draw_unread(scene)
            elif method == SHADOWS:
                scene = next(turning)
            begun_s = time.perf_counter(), clock()
            renderer.draw_unread(scene)
            spent[method].append((time.perf_counter() - begun_s[0], clock() - begun_s[1]))
    whole.draw_unread(wrapped)
    plain_s = np.median(spent[PLAIN][WARM:], axis=0)[1]
    for method, each in spent.items():
        seconds, own_s = np.median(each[WARM:], axis=0)
        yield {"method": method, "on": name, "triangles": figure.triangles, "seconds": float(seconds),
               "own_s": float(own_s), "fps_over_plain": float(plain_s / own_s), "peels": whole.layers,
               "renderer": renderer.name}  # fmt: skip


def errors(renderer: GlRenderer, name: str, materials: Mapping[str, Mesostructure]) -> Row:
    """Largest relative error of the shader's values, and how much of a small picture is not the reference's."""
    figure = figure_scene(name, SMALL)
    scene = figure.scene(materials)
    error = max(gl_vs_reference(body.material, body.mesh, size=SMALL, renderer=renderer) for body in scene.bodies)
    drawn, reference = renderer.draw(scene), ReferenceRenderer().draw(scene)
    seen = drawn.mask | reference.mask
    off = np.abs(drawn.radiance - reference.radiance).max(axis=2) > 1e-3 * reference.radiance.max()
    return {"method": "shader beside NumPy", "on": name, "error": error,
            "other_coverage": float((drawn.mask != reference.mask).sum() / seen.sum()),
            "other_radiance": float(off.sum() / seen.sum())}  # fmt: skip
