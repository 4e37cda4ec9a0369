"""Time of relit frames of the furnished room, all vertices, beside the paper's merge of cuts on the same vertices.

`moving_fast_over_merge`: time of the moving kernel where all fields are read, over that of the merge (Steps 1 to 4) of
the same cuts under the same light, by vertex; `fast_vs_merge_rmse`: how far the radiances differ, over their mean.
`moving_fps`: a chair moves; white bodies, glossy ones in rows. `cached_fps`: eye, light and a reflectance change at
once. `cached_over_moving`: time of the latter over the former. Times are the processor's, of all threads together, over
the number of threads: other programs do not count. `two_thread_speedup` is by the clock, the best frame of each;
a row has the bound that the main thread sets, by the processor.
"""

import time
from collections.abc import Callable

import numba
import numpy as np

from processing.lighting.brdfs import lambert
from processing.lighting.directions import sample_directions
from processing.lighting.light import EnvironmentLight
from processing.lighting.lobe_nodes import Surface
from processing.lighting.moving_kernel import moving_frame
from processing.lighting.relighting import Relighting
from processing.lighting.shells import ShellPlan
from processing.lighting.surroundings import RelitBody, Surroundings
from service.bench import Result
from tests.benchmarks.yardsticks.furniture import FULL, QUICK, PrecomputedPiece, precomputed_furniture
from tests.benchmarks.yardsticks.merge_operands import merge_operands
from tests.benchmarks.yardsticks.relit_furniture import EYE_M, furnish, poses, windows
from tests.reference.merge import merged_light

SEED = 1
MOVED = "chair"
ALBEDO = 0.7

Row = dict[str, object]


def run(*, quick: bool) -> Result:
    """With fields of 32 spheres around 27 000 vertices, or of 8 around 2000."""
    pieces = precomputed_furniture(QUICK if quick else FULL, ShellPlan(8 if quick else 32))
    frames, merged = 3 if quick else 5, 60 if quick else 300
    threads = numba.get_num_threads()
    figures, rows = _against_merge(pieces, merged)
    for glossy in (False, True):
        scene = _scene(pieces, glossy=glossy)
        moving = _timed(lambda k, scene=scene: _move(scene, pieces, k), scene, frames) / threads
        times = {"moving": moving}
        for name, change in _changes(scene).items():
            times[name] = _timed(change, scene, frames) / threads
        rows += [{"method": f"frame: {name}", "material": "glossy" if glossy else "Lambert",
                  "size": f"{scene.first[-1]} vertices", "time_s": seconds, "fps": 1 / seconds}
                 for name, seconds in times.items()]  # fmt: skip
        if not glossy:
            figures |= {"moving_fps": 1 / moving, "cached_fps": 1 / times["eye, light, reflectance"]}
            figures["cached_over_moving"] = times["eye, light, reflectance"] / moving
    speedup, bound = _speedup(pieces, 2 * frames)
    return Result(figures | speedup, rows + bound)


def _scene(pieces: tuple[PrecomputedPiece, ...], *, glossy: bool) -> Relighting:
    scene = Relighting(_bodies(pieces), sample_directions(), windows())
    furnish(scene, tuple(one.piece for one in pieces), glossy=glossy)
    return scene


def _move(scene: Relighting, pieces: tuple[PrecomputedPiece, ...], k: int) -> None:
    """Shift the chair by a centimetre."""
    number = next(i for i, one in enumerate(pieces) if one.piece.name == MOVED)
    pose = poses(tuple(one.piece for one in pieces))[number]
    pose[0, 3] += 0.01 * (k + 1)
    scene.move(number, pose)


def _changes(scene: Relighting) -> dict[str, Callable[[int], None]]:
    """What changes before a frame in which nothing moves; the frame's number comes in."""

    def turn(k: int) -> None:
        angle = 0.1 * (k + 1)
        c, s = np.cos(angle), np.sin(angle)
        scene.turn_light(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]))

    def look(k: int) -> None:
        scene.look_from(EYE_M + 0.05 * (k + 1))

    def all_three(k: int) -> None:
        turn(k + 100)
        look(k + 100)
        scene.paint(0, lambert(np.full(3, 0.5 + 0.01 * k)))

    return {"light": turn, "eye": look, "eye, light, reflectance": all_three}


def _timed(change: Callable[[int], None], scene: Relighting, frames: int) -> float:
    """Processor's seconds of a frame after a change: the median; the first two compile, merge and warm up."""
    seconds = []
    for k in range(frames + 2):
        begun = time.process_time()
        change(k)
        scene.frame()
        seconds.append(time.process_time() - begun)
    return float(np.median(seconds[2:]))


def _against_merge(pieces: tuple[PrecomputedPiece, ...], count: int) -> tuple[dict[str, float], list[Row]]:
    """The kernel on all vertices and the paper's merge on some of them, white, with all fields read."""
    bodies, places, sampled = _bodies(pieces), [one.piece.place for one in pieces], sample_directions()
    first = np.cumsum([0, *(len(one.body.vertices) for one in bodies)])
    light = EnvironmentLight(windows(), sampled).turned(np.eye(3)).sums
    vertices = np.sort(np.random.default_rng(SEED).choice(first[-1], count, replace=False))
    body = np.searchsorted(first, vertices, side="right") - 1
    cuts = [
        merge_operands(bodies, places, sampled, k, vertex - first[k]) for k, vertex in zip(body, vertices, strict=True)
    ]
    merged_light(*cuts[0], light)
    merge, expected = _processor_s(lambda: np.array([merged_light(*one, light) for one in cuts]) * ALBEDO / np.pi)
    around = [_around(bodies, places, k) for k in range(len(bodies))]
    lists, _ = _processor_s(lambda: _all_fields(bodies, around, light))
    fast, found = min(
        (_processor_s(lambda: _all_fields(bodies, around, light)) for _ in range(3)), key=lambda one: one[0]
    )
    apart = found[vertices] - expected
    figures = {
        "moving_fast_over_merge": float(fast / first[-1] / (merge / count)),
        "fast_vs_merge_rmse": float(np.sqrt(np.square(apart).mean()) / expected.mean()),
    }
    rows: list[Row] = [
        {"method": "the paper's merge, all fields", "material": "Lambert", "us_per_vertex": 1e6 * merge / count},
        {"method": "moving kernel, all fields", "material": "Lambert", "us_per_vertex": float(1e6 * fast / first[-1])},
        {"method": "lists at close vertices and of the floor, where all bodies moved", "time_s": lists - fast},
    ]
    return figures, rows


def _around(bodies: list[RelitBody], places: list[np.ndarray], number: int) -> Surroundings:
    found, pose = Surroundings(bodies[number].body, sample_directions()), np.eye(4)
    for k, other in enumerate(bodies):
        if k != number:
            pose[:3, 3] = places[k] - places[number]
            found.meet(k, other, pose.copy())
    return found


def _all_fields(bodies: list[RelitBody], around: list[Surroundings], light: np.ndarray) -> np.ndarray:
    """Radiance of all vertices from the fields, in one thread."""
    white, found = lambert(np.full(3, ALBEDO)), []
    for body, surroundings in zip(bodies, around, strict=True):
        normals = body.body.normals
        vertices, radiance = np.arange(len(normals)), np.empty((len(normals), 3), np.float32)
        means = sample_directions().node_means
        surface = Surface(normals, normals, int(white.kind), white.parameters, white.table, white.heights, means)
        shadows = surroundings.shadows(vertices, surroundings.numbers)
        moving_frame(body.steps(vertices), shadows, surface, light, radiance)
        found.append(radiance)
    return np.concatenate(found)


def _processor_s(work: Callable[[], np.ndarray]) -> tuple[float, np.ndarray]:
    begun = time.process_time()
    found = work()
    return time.process_time() - begun, found


def _bodies(pieces: tuple[PrecomputedPiece, ...]) -> list[RelitBody]:
    return [RelitBody(one.piece.body, one.self_visibility, one.field) for one in pieces]


def _speedup(pieces: tuple[PrecomputedPiece, ...], frames: int) -> tuple[dict[str, float], list[Row]]:
    """One thread's time over two's by the clock, moving frames in turns; and what is left for one thread to do."""
    best, shares = {1: np.inf, 2: np.inf}, []
    usual = numba.get_num_threads()
    scenes = {threads: _scene(pieces, glossy=False) for threads in best}
    try:
        for k in range(frames + 2):
            for threads, scene in scenes.items():
                numba.set_num_threads(min(threads, usual))
                begun, alone, both = time.perf_counter(), time.thread_time(), time.process_time()
                _move(scene, pieces, k)
                scene.frame()
                if k > 1:
                    best[threads] = min(best[threads], time.perf_counter() - begun)
                    shares.append((time.thread_time() - alone) / (time.process_time() - both))
    finally:
        numba.set_num_threads(usual)
    serial = float(np.median(shares))
    row = {"method": "moving frame: what one thread does alone", "serial_share": serial, "bound": 2 / (1 + serial)}
    return {"two_thread_speedup": best[1] / best[2]}, [row]
