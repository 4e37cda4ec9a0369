"""Error against time per frame of a teapot on a floor: spheres of its field, thresholds of the cuts, direct summation.

The truth is direct summation over the tree's directions, each one traced; beside it stand direct summations over fewer
directions and the paper's merge of the same cuts (Steps 1 to 4), whose fields tell of close bodies too. In a moving
frame the teapot moves, and rays are traced from the vertices of the floor that it all but touches; in a kept one the
light turns. Seconds are the processor's, over the number of threads; the merge's leave out how it finds the cuts that
it reads. Errors are root mean squares over the mean of the truth, of all vertices; `flip`
is of the drawn picture. `teapot_error_monotone`: 1 where the error falls from each number of spheres to the next, at
the finest cuts.
"""

import time
from collections.abc import Callable, Sequence
from itertools import pairwise

import numba
import numpy as np

from processing.lighting.directions import HEIGHT, sample_directions
from processing.lighting.light import EnvironmentLight
from processing.lighting.precomputation import TOLERANCE
from processing.lighting.relighting import Relighting
from processing.lighting.shells import ShellPlan
from processing.lighting.surroundings import RelitBody
from processing.products.arrays import Float64
from render.relit_view import open_relit_view
from service.bench import Result
from tests.benchmarks.yardsticks.merge_operands import merge_operands
from tests.benchmarks.yardsticks.picture_difference import mean_flip
from tests.benchmarks.yardsticks.relit_furniture import windows
from tests.benchmarks.yardsticks.teapot_scene import CLEARANCE, TEAPOT, WHITE, TeapotScene, teapot_scene
from tests.reference.merge import merged_light

RESOLUTIONS = 8, 16, 32, 64
TOLERANCES = TOLERANCE / 4, TOLERANCE, 4 * TOLERANCE
LOWER = 6, 4, 2  # halvings of the directions
UNIT = "shares of the mean"
PAINT = WHITE, WHITE

Row = dict[str, object]


class _Judge:
    """The truth of all vertices, and how far others are from it, as numbers and as pictures."""

    def __init__(self, scene: TeapotScene, height: int, size: tuple[int, int]) -> None:
        self.scene, self.sampled = scene, sample_directions(height)
        self.vertices = np.arange(scene.first[-1])
        begun = time.process_time()
        self.truth = scene.direct(self.vertices, self.sampled, windows(), PAINT)
        self.seconds = time.process_time() - begun
        self._view, self._camera = open_relit_view(scene.meshes), scene.camera(size)
        self._picture = self.picture(self.truth)

    def picture(self, radiance: Float64) -> np.ndarray:
        drawn = self._view.draw(self._camera, self.scene.poses, radiance.astype(np.float32))
        return np.asarray(drawn.radiance, np.float64)

    def errors(self, radiance: Float64) -> Row:
        apart = np.square(radiance - self.truth).mean()
        flip = mean_flip(self._picture[None], self.picture(radiance)[None])
        return {"error": float(np.sqrt(apart) / self.truth.mean()), "flip": flip, "unit": UNIT}

    def release(self) -> None:
        self._view.release()


def run(*, quick: bool) -> Result:
    """Of 7600 vertices and 32 768 directions, or of 850 and 8192 with coarser fields."""
    scene = teapot_scene(0.25, 14) if quick else teapot_scene(0.7, 60)
    resolutions, tolerances = (RESOLUTIONS[:3], TOLERANCES[1:]) if quick else (RESOLUTIONS, TOLERANCES)
    judge = _Judge(scene, HEIGHT - 2 if quick else HEIGHT, (240, 180) if quick else (640, 480))
    fields = [scene.field(judge.vertices, judge.sampled, ShellPlan(resolution)) for resolution in resolutions]
    rows: list[Row] = []
    errors = np.zeros((len(tolerances), len(resolutions)))
    for i, tolerance in enumerate(tolerances):
        cuts = scene.cuts(judge.vertices, judge.sampled, tolerance)
        for j, (field, resolution) in enumerate(zip(fields, resolutions, strict=True)):
            found = _relit(judge, scene.relit(cuts, field), tolerance, resolution, frames=3 if quick else 5)
            errors[i, j] = found[0]["error"]
            rows += found
    rows += _directly(judge)
    judge.release()
    monotone = all(after < before for before, after in pairwise(errors[0]))
    return Result({"teapot_error_monotone": float(monotone)}, rows + _curves(errors, tolerances, resolutions))


def _relit(judge: _Judge, bodies: list[RelitBody], tolerance: float, resolution: int, frames: int) -> list[Row]:
    """A moving frame, a kept one and, at the usual cuts, the paper's merge."""
    scene = judge.scene.relighting(bodies, judge.sampled, windows(), PAINT)
    moving = judge.errors(scene.frame().radiance)
    size: Row = {"size": f"{resolution} spheres"}
    rows = [{"method": f"moving, cuts to {tolerance:g}", **size, **moving, "seconds": _seconds(scene, _move, frames)}]
    if tolerance == TOLERANCE:
        rows.append({"method": "the paper's merge, fields alone", "peer": True, **size, **_merge(judge, bodies)})
    kept_s = _seconds(scene, _turn, frames)
    scene.turn_light(np.eye(3))
    kept = judge.errors(scene.frame().radiance)
    return [*rows, {"method": f"kept, cuts to {tolerance:g}", **size, **kept, "seconds": kept_s}]


def _move(scene: Relighting, k: int) -> None:
    """By less than what would ask for other sample points."""
    pose = np.eye(4)
    pose[:3, 3] = 1e-7 * (k + 1), 0, CLEARANCE
    scene.move(TEAPOT, pose)


def _turn(scene: Relighting, k: int) -> None:
    c, s = np.cos(0.1 * (k + 1)), np.sin(0.1 * (k + 1))
    scene.turn_light(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]))


def _seconds(scene: Relighting, change: Callable[[Relighting, int], None], frames: int) -> float:
    """The median of frames after a change; the first two compile, merge and warm up."""
    found = []
    for k in range(frames + 2):
        begun = time.process_time()
        change(scene, k)
        scene.frame()
        found.append(time.process_time() - begun)
    return float(np.median(found[2:])) / numba.get_num_threads()


def _merge(judge: _Judge, bodies: list[RelitBody]) -> Row:
    """Seconds and errors of the merge, fields alone; what it reads is found beforehand."""
    places = [pose[:3, 3] for pose in judge.scene.poses]
    sums = EnvironmentLight(windows(), judge.sampled).turned(np.eye(3)).sums
    cuts = [
        merge_operands(bodies, places, judge.sampled, number, vertex, fields_alone=True)
        for number, count in enumerate(np.diff(judge.scene.first))
        for vertex in range(count)
    ]
    merged_light(*cuts[0], sums)
    begun = time.process_time()
    found = np.array([merged_light(*one, sums) for one in cuts])
    seconds = (time.process_time() - begun) / numba.get_num_threads()
    return {**judge.errors(found * WHITE.parameters[:3]), "seconds": seconds}


def _directly(judge: _Judge) -> list[Row]:
    """Direct summation over all directions and over fewer."""
    rows: list[Row] = []
    for height in (*(judge.sampled.height - lower for lower in LOWER), judge.sampled.height):
        whole = height == judge.sampled.height
        begun = time.process_time()
        found = (
            judge.truth if whole else judge.scene.direct(judge.vertices, sample_directions(height), windows(), PAINT)
        )
        seconds = judge.seconds if whole else time.process_time() - begun
        method = f"direct summation, {1 << height} directions"
        rows.append(
            {"method": method, "peer": True, **judge.errors(found), "seconds": seconds / numba.get_num_threads()}
        )
    return rows


def _curves(errors: Float64, tolerances: Sequence[float], resolutions: Sequence[int]) -> list[Row]:
    """The same errors as lines over either parameter."""
    return [
        {"method": method, "parameter": parameter, "value": value, "error": float(error), "unit": UNIT}
        for (i, j), error in np.ndenumerate(errors)
        for method, parameter, value in (
            (f"cuts to {tolerances[i]:g}", "spheres of the field", resolutions[j]),
            (f"{resolutions[j]} spheres", "tolerance of the cuts", tolerances[i]),
        )
    ]
