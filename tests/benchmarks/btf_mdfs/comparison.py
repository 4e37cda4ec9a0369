"""Ways to draw relief on the same meshes in one run: error along silhouettes, masks, time of a frame, and bytes.

The truth is ray-traced relief (`displaced`). Rows have, for each scene and method, the mean FLIP in a band of 8 pixels
around the true silhouettes and over the whole picture, the masks' intersection over union, a frame's time (of a
software rasteriser the processor's) over that of the plain BTF, frames having taken turns, and the bytes of the maps.
Pictures are drawn with 2 x 2 samples to a pixel, frames for time with one. The peers' maps are true, of as many texels
as the BTF, and their shaders reflect as the samples do: a measured height map with fitted materials would do worse.
Shadows of the macro surface are in the truth, and drawn by none but where the method says so.
"""

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from render.errors import GlUnavailableError
from render.materials import Material
from render.opengl import GlRenderer
from render.picture import Picture
from service.bench import Result
from tests.benchmarks.yardsticks.bands import flip_map, mask_iou, silhouette_band
from tests.benchmarks.yardsticks.displaced import Covered, Displaced, TruePicture
from tests.benchmarks.yardsticks.figure_scenes import FigureScene, cylinder_scene, knot_scene, torus_scene
from tests.benchmarks.yardsticks.mesostructures import mesostructure, polar_grid
from tests.benchmarks.yardsticks.relief_peers import METHODS, ReliefMaps, ReliefRenderer, relief_maps
from tests.benchmarks.yardsticks.sample_periods import period

Row = dict[str, object]
SEED = 1
SUPERSAMPLING = 2
WARM = 2  # frames that compile and upload
PLAIN = "plain BTF"


@dataclass(frozen=True)
class _Size:
    """Pixels of a picture, texels of a map, rank of the BTF, directions as (azimuths, polar angles), frames to time."""

    picture: tuple[int, int]
    texels: int
    rank: int
    directions: tuple[int, tuple[float, ...]]
    frames: int


_QUICK = _Size((160, 120), 24, 4, (6, (35.0, 65.0)), 4)
_FULL = _Size((400, 300), 64, 4, (12, (20.0, 40.0, 55.0, 65.0, 75.0)), 12)


@dataclass(frozen=True)
class _Way:
    """A way to draw: the picture, a frame that nobody reads, and the bytes of its maps."""

    draw: Callable[[FigureScene], Picture]
    draw_unread: Callable[[FigureScene], None]
    nbytes: int


def run(*, quick: bool) -> Result:
    """Rows of every scene; quick of one, of few texels, directions and pixels."""
    try:
        renderer = GlRenderer()
    except GlUnavailableError as error:
        return Result({}, [{"method": "comparison", "missing": str(error)}])
    peers, size = ReliefRenderer(renderer.context), _QUICK if quick else _FULL
    try:
        rows = [
            row for name, figure in _figures(quick, size) for row in _compared(name, figure, (renderer, peers), size)
        ]
    finally:
        peers.release()
        renderer.release()
    return Result({}, rows)


def _figures(quick: bool, size: _Size) -> Iterator[tuple[str, FigureScene]]:
    """Scenes of one sample each."""
    yield "torus 3 x 1, brick", torus_scene((3, 1), size.picture)
    if not quick:
        yield "torus 3 x 1, weave", torus_scene((3, 1), size.picture, "weave")
        yield "torus 8 x 3, brick", torus_scene((8, 3), size.picture)
        yield "cylinder, brick", cylinder_scene(size.picture)
        yield "knot, weave", knot_scene(size.picture, "weave")


def _compared(
    name: str, figure: FigureScene, renderers: tuple[GlRenderer, ReliefRenderer], size: _Size
) -> Iterator[Row]:
    """What each way costs and how far its picture is from the truth."""
    true = truth(figure)
    band, ways = silhouette_band(true), _ways(figure.samples, renderers, size)
    spent = _times(figure, ways, renderers[0].name, size.frames)
    fine = replace(figure, camera=figure.camera.scaled(SUPERSAMPLING))
    for method, way in ways.items():
        picture = way.draw(fine).averaged(SUPERSAMPLING)
        apart = flip_map(true.picture, picture)
        yield {"method": method, "on": name, "band_flip": float(apart[band].mean()), "flip": float(apart.mean()),
               "mask_iou": mask_iou(true.picture, picture), "own_s": spent[method],
               "over_plain_s": spent[method] / spent[PLAIN], "bytes": way.nbytes,
               "triangles": figure.triangles}  # fmt: skip


def truth(figure: FigureScene) -> TruePicture:
    """The ray-traced picture of the scene with its own samples."""
    bodies = [Covered(body.surface, body.tiles, period(body.sample, SEED)) for body in figure.bodies]
    return Displaced(bodies).seen(figure.camera, figure.lights)


def _ways(samples: tuple[str, ...], renderers: tuple[GlRenderer, ReliefRenderer], size: _Size) -> dict[str, _Way]:
    """All ways by name, with the materials of the samples."""
    azimuths, polar_deg = size.directions
    grid = polar_grid(azimuths, polar_deg)
    structures = {name: mesostructure(name, SEED, size.texels, grid, grid, rank=size.rank) for name in samples}
    maps = {name: relief_maps(name, SEED, size.texels) for name in samples}
    plain = {name: each.btf.coded(np.uint8) for name, each in structures.items()}
    drawn = {PLAIN: _by_material(renderers[0], plain, sum(each.nbytes for each in plain.values()))}
    return drawn | {method: _by_maps(renderers[1], method, maps) for method in METHODS}


def _by_material(renderer: GlRenderer, materials: Mapping[str, Material], nbytes: int) -> _Way:
    return _Way(
        lambda figure: renderer.draw(figure.scene(materials)),
        lambda figure: renderer.draw_unread(figure.scene(materials)),
        nbytes,
    )


def _by_maps(peers: ReliefRenderer, method: str, maps: Mapping[str, ReliefMaps]) -> _Way:
    return _Way(
        lambda figure: peers.draw(method, figure, maps),
        lambda figure: peers.draw_unread(method, figure, maps),
        sum(each.nbytes for each in maps.values()),
    )


def _times(figure: FigureScene, ways: Mapping[str, _Way], renderer: str, frames: int) -> dict[str, float]:
    """Median time in seconds of a frame by each way, frames having taken turns."""
    # What else runs delays long frames more than short ones; a software rasteriser's own time does not know of it.
    clock = time.process_time if "llvmpipe" in renderer else time.perf_counter
    spent: dict[str, list[float]] = {method: [] for method in ways}
    for _ in range(WARM + frames):
        for method, way in ways.items():
            begun_s = clock()
            way.draw_unread(figure)
            spent[method].append(clock() - begun_s)
    return {method: float(np.median(each[WARM:])) for method, each in spent.items()}
