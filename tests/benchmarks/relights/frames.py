"""Time of relit frames of the furnished room, all vertices, beside the paper's merge of cuts on the same vertices.

`moving_fast_over_merge`: time of a frame in which all fields are read anew, over that of the merge (Steps 1 to 4) of
the same cuts under the same light, by vertex; `fast_vs_merge_rmse`: how far the radiances differ, over their mean.
`moving_fps`: a chair moves; white bodies, glossy ones in rows. `cached_fps`: eye, light and a reflectance change at
once. `cached_over_moving`: time of the latter over the former. Times are the processor's, of all threads together, over
the number of threads: other programs do not count. `two_thread_speedup` is by the clock, the best frame of each.
"""

import time
from collections.abc import Callable

import numba
import numpy as np

from processing.lighting.brdfs import lambert
from processing.lighting.directions import sample_directions
from processing.lighting.light import EnvironmentLight
from processing.lighting.relighting import Relighting
from processing.lighting.shells import ShellPlan
from processing.lighting.surroundings import RelitBody
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
    figures["two_thread_speedup"] = _speedup(pieces, frames)
    return Result(figures, rows)


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
    """The kernel on all vertices and the paper's merge on some of them, all fields read, Lambert."""
    scene = _scene(pieces, glossy=False)
    for number in range(len(pieces)):
        scene.paint(number, lambert(np.full(3, ALBEDO)))
    vertices = np.sort(np.random.default_rng(SEED).choice(scene.first[-1], count, replace=False))
    light = EnvironmentLight(windows(), sample_directions()).turned(np.eye(3)).sums
    cuts = [_operands(pieces, scene.first, vertex) for vertex in vertices]
    merged_light(*cuts[0], light)
    begun = time.process_time()
    expected = np.array([merged_light(*one, light) for one in cuts]) * ALBEDO / np.pi
    merge = time.process_time() - begun
    times = []
    for spread in (1.1, 1.0) * 3:
        _move_all(scene, pieces, spread)
        begun = time.process_time()
        found = scene.frame().radiance[vertices]
        times.append(time.process_time() - begun)
    rmse = float(np.sqrt(np.square(found - expected).mean()) / expected.mean())
    fast = float(np.median(times[3::2])) * count / int(scene.first[-1])
    figures = {"moving_fast_over_merge": fast / merge, "fast_vs_merge_rmse": rmse}
    rows: list[Row] = [
        {"method": name, "material": "Lambert", "us_per_vertex": 1e6 * seconds / count}
        for name, seconds in (("the paper's merge, all fields", merge), ("moving kernel, all fields", fast))
    ]
    return figures, rows


def _move_all(scene: Relighting, pieces: tuple[PrecomputedPiece, ...], spread: float) -> None:
    """Put all pieces in place, or further apart."""
    for number, pose in enumerate(poses(tuple(one.piece for one in pieces))):
        pose[:2, 3] *= spread
        scene.move(number, pose)


def _operands(pieces: tuple[PrecomputedPiece, ...], first: np.ndarray, vertex: int) -> tuple[np.ndarray, ...]:
    number = int(np.searchsorted(first, vertex, side="right")) - 1
    places = [one.piece.place for one in pieces]
    return merge_operands(_bodies(pieces), places, sample_directions(), number, vertex - first[number])


def _bodies(pieces: tuple[PrecomputedPiece, ...]) -> list[RelitBody]:
    return [RelitBody(one.piece.body, one.self_visibility, one.field) for one in pieces]


def _speedup(pieces: tuple[PrecomputedPiece, ...], frames: int) -> float:
    """One thread's time over two's by the clock, moving frames."""
    best: dict[int, float] = {}
    usual = numba.get_num_threads()
    try:
        for threads in (1, 2):
            numba.set_num_threads(min(threads, usual))
            scene = _scene(pieces, glossy=False)
            for k in range(frames + 2):
                begun = time.perf_counter()
                _move(scene, pieces, k)
                scene.frame()
                best[threads] = min(best.get(threads, np.inf), time.perf_counter() - begun) if k > 1 else np.inf
    finally:
        numba.set_num_threads(usual)
    return best[1] / best[2]
