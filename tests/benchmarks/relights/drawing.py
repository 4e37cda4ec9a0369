"""Pictures of the relit furnished room, and frames by compute shaders beside those by the processor's threads.

Rows only. `time_s` is by the clock, the best of some frames, `processor_s` the processor's seconds of the same frames
of all threads together: a software rasteriser, which `renderer` names, spends its time there. `visible_share`: of the
room's vertices, those that a picture from the usual place needs. `rmse_vs_threads`: how far radiances of compute
shaders are from those of the threads, over their mean.
"""

import time
from collections.abc import Callable

import numpy as np

from processing.lighting.cached_kernel import CachedFrame, frame_in_threads
from processing.lighting.directions import sample_directions
from processing.lighting.relighting import Relighting
from processing.lighting.shells import ShellPlan
from processing.lighting.surroundings import RelitBody
from processing.products.arrays import Float32
from render.camera import Camera, look_at
from render.errors import GlUnavailableError
from render.mesh import plain_mesh
from render.relit_view import RelitView
from service.bench import Result
from service.relit_on_card import FrameOnCard
from tests.benchmarks.yardsticks.furniture import FULL, QUICK, Piece, PrecomputedPiece, furniture, precomputed_furniture
from tests.benchmarks.yardsticks.relit_furniture import EYE_M, furnish, poses, windows

SIZE = 800, 600

Row = dict[str, object]


def run(*, quick: bool) -> Result:
    """Pictures of 27 000 vertices; frames of as many in fields of 32 spheres, or of 2000 in 8."""
    repeats = 3 if quick else 10
    pieces = precomputed_furniture(QUICK if quick else FULL, ShellPlan(8 if quick else 32))
    try:
        return Result({}, [*_pictures(furniture(FULL), repeats), *_frames(pieces, repeats)])
    except GlUnavailableError as error:
        return Result({}, [{"method": "OpenGL", "note": str(error)}])


def usual_camera(size: tuple[int, int] = SIZE, step: int = 0) -> Camera:
    """The room from the eye's usual place, or some centimetres higher."""
    return look_at(EYE_M + np.array([0.0, 0.0, 0.01 * step]), (0.0, -0.1, 0.35), size, field_of_view_rad=0.8)


def _pictures(pieces: tuple[Piece, ...], repeats: int) -> list[Row]:
    view = RelitView([plain_mesh(each.body.vertices, each.body.normals, each.body.triangles) for each in pieces])
    camera, where = usual_camera(), poses(pieces)
    count = len(view.bodies.positions)
    radiance = np.random.default_rng(1).uniform(0, 1, (count, 3)).astype(np.float32)
    visible = view.visible(camera, where)
    known: Row = {"size": f"{count} vertices, {SIZE[0]} x {SIZE[1]}", "renderer": view.name}
    rows = [
        {"method": "IDs of triangles", **known, "visible_share": len(visible) / count}
        | _timed(lambda k: view.visible(usual_camera(step=k + 1), where), repeats),
        {"method": "picture", **known} | _timed(lambda k: view.draw(camera, where, radiance), repeats),
    ]
    view.release()
    return rows


def _frames(pieces: tuple[PrecomputedPiece, ...], repeats: int) -> list[Row]:
    """Frames after the light was turned, white and glossy."""
    card = FrameOnCard()
    ways: dict[str, CachedFrame] = {"the processor's threads": frame_in_threads, card.name: card}
    rows: list[Row] = []
    for glossy in (False, True):
        expected = None
        for name, way in ways.items():
            seconds, radiance = _frames_by(way, pieces, repeats, glossy=glossy)
            expected = radiance if expected is None else expected
            apart = float(np.sqrt(np.square(radiance - expected).mean()) / expected.mean())
            rows.append(
                {"method": "cached frame: light", "material": "glossy" if glossy else "Lambert", "renderer": name,
                 "size": f"{len(radiance)} vertices", "rmse_vs_threads": apart, **seconds}
            )  # fmt: skip
    card.release()
    return rows


def _frames_by(
    way: CachedFrame, pieces: tuple[PrecomputedPiece, ...], repeats: int, *, glossy: bool
) -> tuple[Row, Float32]:
    bodies = [RelitBody(one.piece.body, one.self_visibility, one.field) for one in pieces]
    scene = Relighting(bodies, sample_directions(), windows(), way)
    furnish(scene, tuple(one.piece for one in pieces), glossy=glossy)

    def turned(k: int) -> None:
        c, s = np.cos(0.1 * k), np.sin(0.1 * k)
        scene.turn_light(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]))
        scene.frame()

    return _timed(turned, repeats), scene.frame().radiance


def _timed(work: Callable[[int], object], repeats: int) -> Row:
    """After two times to warm up: the best by the clock, and the processor's median."""
    clock, processor = [], []
    for k in range(repeats + 2):
        begun = time.perf_counter(), time.process_time()
        work(k)
        clock.append(time.perf_counter() - begun[0])
        processor.append(time.process_time() - begun[1])
    return {"time_s": min(clock[2:]), "processor_s": float(np.median(processor[2:]))}
