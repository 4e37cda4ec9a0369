"""Frames of an SBRDF+: their cost over flat ones and beside Mitsuba, how far the shader is from NumPy, shimmer.

Frames of 300 x 300 under one light, drawn in turns by the same renderer. The SBRDF+ is made by formula at the paper's
size: 81 x 81 directions, 64 x 64 texels, three lobes, a sixth of the points hidden, in patches. `frame_over_flat`, of
a software rasteriser the processor's time, is the worst of a plane that fills the frame, a sphere, a torus and a
statue, with levels and without; rows have all points hidden. `speedup_vs_mitsuba_btf` is per shaded sample over a BSDF
in Python in a variant without just-in-time compiler, which asks sample by sample; rows have its look-up alone, of many
samples at once, which is less than a plug-in costs. Shimmer is of an analysed brick on a plane that recedes to the
horizon.
"""

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from processing.products import Btf, SbrdfPlus
from processing.sbrdf.analysis import analyse
from processing.sbrdf.levels import coarser_levels
from render.camera import Camera, look_at
from render.comparison import gl_vs_reference
from render.errors import GlUnavailableError
from render.materials import Material
from render.mesh import Mesh
from render.opengl import GlRenderer
from render.scene import Scene, framed, light
from render.shapes import plane, sphere, statue, torus
from service.bench import Result
from tests.benchmarks.yardsticks import mitsuba_btf
from tests.benchmarks.yardsticks.btf_samples import quick_directions, ray_traced
from tests.benchmarks.yardsticks.material_samples import bonn_directions, rings
from tests.render import synthetic

Row = dict[str, object]
SEED = 1
SIZE = (300, 300)
WARM = 3  # frames that compile and upload
HIDDEN = 1 / 6  # of the paper's points after its refinement
KEY = light(np.radians(-35.0), np.radians(40.0))
SUPERSAMPLING = 8
SHIFTS = 8  # of the camera within a pixel


def run(*, quick: bool) -> Result:
    """Times, errors and shimmer; quick with fewer frames, smaller pictures and a tile of few texels."""
    try:
        renderer = GlRenderer()
    except GlUnavailableError as error:
        return Result({}, [{"method": "frames", "missing": str(error)}])
    try:
        times = [row for name in _meshes() for row in frame_times(renderer, name, quick)]
        errors = list(shader_errors(renderer, (80, 80) if quick else SIZE))
        shimmer = list(shimmers(renderer, brick(SEED, quick), (96, 64) if quick else SIZE))
    finally:
        renderer.release()
    figures = {
        "frame_over_flat": max(float(row["over_flat"]) for row in times if row["method"] in ("SBRDF+", "with levels")),
        "gl_vs_reference": max(float(row["error"]) for row in errors),
    }
    speedup, beside = beside_mitsuba(min(float(row["sample_s"]) for row in times if row["method"] == "SBRDF+"), quick)
    return Result(figures | speedup, [*times, *errors, *shimmer, *beside])


def woven(**kind: float) -> SbrdfPlus:
    """The paper's size, by formula."""
    centres = 1984
    return synthetic.weave((64, 64), centres=centres, directions=bonn_directions(), **{"hidden": HIDDEN, **kind})


def frame_times(renderer: GlRenderer, name: str, quick: bool) -> Iterator[Row]:
    """Medians of frames that took turns: time on the clock, of the processor, over that of flat ones, and per pixel."""
    mesh, camera = _meshes()[name]
    fine = woven()
    levels = tuple(synthetic.weave((side, side), directions=bonn_directions()) for side in (32, 16, 8, 4, 2, 1))
    # No more than the renderer keeps on the card.
    materials: dict[str, Material] = {
        "flat": synthetic.pattern(64),
        "SBRDF+": fine,
        "with levels": replace(fine, coarser=levels),
        "all hidden": woven(hidden=1.1),
    }
    scenes = {method: Scene.of(mesh, material, camera, (KEY,)) for method, material in materials.items()}
    # What else runs delays long frames more than short ones; a software rasteriser's own time does not know of it.
    clock = time.process_time if "llvmpipe" in renderer.name else time.perf_counter
    spent: dict[str, list[tuple[float, float]]] = {method: [] for method in scenes}
    for _ in range(WARM + (6 if quick else 40)):
        for method, scene in scenes.items():
            begun_s = time.perf_counter(), clock()
            renderer.draw_unread(scene)
            spent[method].append((time.perf_counter() - begun_s[0], clock() - begun_s[1]))
    drawn = int(renderer.draw(scenes["flat"]).mask.sum())
    flat_s = np.median(spent["flat"][WARM:], axis=0)[1]
    for method, each in spent.items():
        seconds, own_s = np.median(each[WARM:], axis=0)
        yield {"method": method, "on": name, "seconds": float(seconds), "own_s": float(own_s),
               "p95_s": float(np.percentile(each[WARM:], 95, axis=0)[0]), "over_flat": float(own_s / flat_s),
               "sample_s": float(seconds / drawn), "renderer": renderer.name}  # fmt: skip


def shader_errors(renderer: GlRenderer, size: tuple[int, int]) -> Iterator[Row]:
    """Largest relative error against NumPy on each mesh, with levels and without."""
    fine = woven()
    levels = tuple(woven_at(side) for side in (32, 16, 8, 4, 2, 1))
    for method, material in (("shader", fine), ("shader with levels", replace(fine, coarser=levels))):
        for name in _meshes():
            mesh = plane(tiles=(12.0, 9.0)) if name == "plane" else _meshes()[name][0]
            yield {"method": method, "on": name, "error": gl_vs_reference(material, mesh, size=size, renderer=renderer)}


def woven_at(side: int) -> SbrdfPlus:
    """A level of so many texels a side, which has nothing to do with the others."""
    return synthetic.weave((side, side), centres=max(side, 4), seed=side, directions=bonn_directions())


def brick(seed: int, quick: bool) -> SbrdfPlus:
    """An analysed brick with the levels of its averaged BTF; quick of few texels and directions."""
    texels, directions = (12, rings(((0, 1), (45, 6)))) if quick else (32, quick_directions())
    btf = ray_traced("brick", texels, seed, directions, directions).btf
    return replace(analyse(btf).product, coarser=coarser_levels(btf, lambda level: analyse(level).product))


def shimmers(renderer: GlRenderer, material: SbrdfPlus, size: tuple[int, int]) -> Iterator[Row]:
    """With levels and without: error over shifts of the camera within a pixel, and how much of it comes and goes.

    Both are root mean squares over the lit pixels, over the mean of the supersampled truth, which is of the finest
    level; what comes and goes is the error's deviation over the shifts.
    """
    mesh = plane(40.0, tiles=(80.0, 80.0), shape=(64, 64))
    fine = replace(material, coarser=())
    cameras = [receding(size, shift) for shift in _shifts()]
    truth = np.stack([_supersampled(renderer, Scene.of(mesh, fine, camera, (KEY,))) for camera in cameras])
    for method, drawn in (("with levels", material), ("without levels", fine)):
        frames = np.stack([renderer.draw(Scene.of(mesh, drawn, camera, (KEY,))).radiance for camera in cameras])
        inside = (frames > 0).all(axis=(0, 3)) & (truth > 0).all(axis=(0, 3))
        error = (frames - truth)[:, inside]
        mean = truth[:, inside].mean()
        yield {"method": method, "on": "receding plane", "unit": "shares of the mean",
               "error": float(np.sqrt((error**2).mean()) / mean), "shimmer": float(error.std(axis=0).mean() / mean),
               "shimmer_of_truth": float(truth[:, inside].std(axis=0).mean() / mean),
               "contrast": float(frames[:, inside].std() / truth[:, inside].std())}  # fmt: skip


def receding(size: tuple[int, int], shift_px: tuple[float, float]) -> Camera:
    """A camera above a plane that it sees to its far end, moved within a pixel."""
    camera = look_at([0.0, -19.0, 1.2], [0.0, -14.0, 0.0], size, field_of_view_rad=0.7)
    matrix = camera.matrix.copy()
    matrix[:2, 2] += shift_px
    return replace(camera, matrix=matrix)


def beside_mitsuba(ours_s: float, quick: bool) -> tuple[dict[str, float], list[Row]]:
    """Per shaded sample: a BSDF in Python over a BTF of the same directions, and its look-up alone."""
    directions, rng = bonn_directions(), np.random.default_rng(SEED)
    btf = Btf(rng.uniform(0, 1, (81, 81, 16, 16, 3)).astype(np.float32), directions, directions)
    look_up, samples = mitsuba_btf.NearestPairs(btf), 20_000 if quick else 100_000
    near = directions[[40]] + 0.02 * rng.normal(size=(samples, 3))
    far = np.tile(directions[[30]], (samples, 1))
    begun_s = time.perf_counter()
    look_up(rng.uniform(0, 1, (samples, 2)), far, near)
    alone_s = (time.perf_counter() - begun_s) / samples
    rows: list[Row] = [{"method": "nearest pairs, look-up alone", "sample_s": alone_s, "over_ours": alone_s / ours_s}]
    try:
        theirs_s, _ = mitsuba_btf.rendered(btf, 40 if quick else 120)
    except ImportError as error:
        return {}, [*rows, {"method": "Mitsuba", "missing": str(error)}]
    rows.append({"method": f"Mitsuba {mitsuba_btf.VARIANT}", "sample_s": theirs_s, "over_ours": theirs_s / ours_s})
    return {"speedup_vs_mitsuba_btf": theirs_s / ours_s}, rows


def _meshes() -> dict[str, tuple[Mesh, Camera]]:
    """Each with a camera; the plane fills the frame."""
    shapes = {"sphere": sphere(shape=(65, 125)), "torus": torus(), "statue": statue()}
    view = {"azimuth_rad": np.radians(-35.0), "elevation_rad": np.radians(35.0)}
    above = look_at([0.0, -0.8, 1.2], [0.0, 0.0, 0.0], SIZE, field_of_view_rad=0.6)
    return {"plane": (plane(tiles=(2.0, 2.0)), above)} | {
        name: (mesh, framed(mesh, SIZE, **view)) for name, mesh in shapes.items()
    }


def _shifts() -> list[tuple[float, float]]:
    """Within a pixel, spread evenly over it."""
    golden = np.array([0.7548776662466927, 0.5698402909980532])  # Roberts's sequence
    return [(float(x), float(y)) for x, y in (np.arange(SHIFTS)[:, None] * golden) % 1.0 - 0.5]


def _supersampled(renderer: GlRenderer, scene: Scene) -> np.ndarray:
    fine = renderer.draw(replace(scene, camera=scene.camera.scaled(SUPERSAMPLING)))
    return fine.averaged(SUPERSAMPLING).radiance
