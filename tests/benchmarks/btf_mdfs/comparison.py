"""Ways to draw relief on the same meshes in one run: error along silhouettes, masks, time of a frame, and bytes.

The truth is ray-traced relief (`displaced`). Rows have, for each scene (`size`) and method, as `error` the mean FLIP
in a band of 8 pixels around the true silhouettes and over the whole picture, the masks' intersection over union, a
frame's time (of a software rasteriser the processor's) over that of the plain BTF, frames having taken turns, and the
bytes of the maps. Pictures are drawn with 2 x 2 samples to a pixel; frames for time with one and 800 x 600 pixels, but
for the paper's test: that is drawn by NumPy, whose time says nothing. The peers' maps are true, of as many texels as
the BTF, and their shaders reflect as the samples do: a measured height map with fitted materials would do worse.
Shadows of bodies are in the truth, and drawn by none but where the method says so.
"""

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from render.errors import GlUnavailableError
from render.materials import Material
from render.opengl import GlRenderer
from render.picture import Picture
from render.scene import Scene
from service.bench import Result
from tests.benchmarks.btf_mdfs.accuracy import FULL, QUICK, SEED, Measured, truth
from tests.benchmarks.yardsticks import paper_silhouettes
from tests.benchmarks.yardsticks.bands import flip_map, mask_iou, silhouette_band
from tests.benchmarks.yardsticks.figure_scenes import SIZE, FigureScene, cylinder_scene, knot_scene, torus_scene
from tests.benchmarks.yardsticks.relief_peers import METHODS, ReliefMaps, ReliefRenderer, relief_maps

Row = dict[str, object]
SUPERSAMPLING = 2
WARM = 2  # frames that compile and upload
PLAIN, PAPER, OURS, SHADOWS = "plain BTF", "paper's test", "BTF with depths", "BTF with depths, shadows"


@dataclass(frozen=True)
class _Size:
    """Pixels of a picture, frames to time, and how samples are measured."""

    picture: tuple[int, int]
    frames: int
    measured: Measured


_QUICK = _Size((160, 120), 2, QUICK)
_FULL = _Size(SIZE, 6, FULL)


@dataclass(frozen=True)
class _Way:
    """A way to draw: the picture, the bytes of its maps, and, where time says something, a frame that nobody reads."""

    draw: Callable[[FigureScene], Picture]
    nbytes: int
    draw_unread: Callable[[FigureScene], None] | None = None


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
    band, ways = silhouette_band(true), dict(_ways(figure.samples, renderers, size.measured))
    whole = replace(figure, camera=figure.camera.resized(SIZE))
    spent = _times(whole, ways, renderers[0].name, size.frames)
    fine = replace(figure, camera=figure.camera.scaled(SUPERSAMPLING))
    for method, way in ways.items():
        picture = way.draw(fine).averaged(SUPERSAMPLING)
        apart = flip_map(true.picture, picture)
        row: Row = {"method": method, "size": name, "error": float(apart[band].mean()), "unit": "FLIP",
               "flip": float(apart.mean()), "mask_iou": mask_iou(true.picture, picture), "bytes": way.nbytes,
               "peer": method not in (OURS, SHADOWS)}  # fmt: skip
        if method in spent:
            row |= {"seconds": spent[method], "over_plain_s": spent[method] / spent[PLAIN]}
        yield row


def _ways(
    samples: tuple[str, ...], renderers: tuple[GlRenderer, ReliefRenderer], measured: Measured
) -> Iterator[tuple[str, _Way]]:
    """All ways with their names, for materials of these samples."""
    structures = {name: measured.of(name) for name in samples}
    maps = {name: relief_maps(name, SEED, measured.texels) for name in samples}
    plain = {name: each.btf for name, each in structures.items()}
    nbytes = sum(each.btf.nbytes + each.depths.nbytes for each in structures.values())
    yield PLAIN, _by_material(renderers[0], plain, sum(each.nbytes for each in plain.values()))
    for method in METHODS:
        yield method, _by_maps(renderers[1], method, maps)
    yield PAPER, _Way(lambda figure: paper_silhouettes.draw(figure.scene(structures)), nbytes)
    yield OURS, _by_material(renderers[0], structures, nbytes)
    yield SHADOWS, _by_material(renderers[0], structures, nbytes, shadows=True)


def _by_material(
    renderer: GlRenderer, materials: Mapping[str, Material], nbytes: int, *, shadows: bool = False
) -> _Way:
    def scene(figure: FigureScene) -> Scene:
        return replace(figure.scene(materials), shadows=shadows)

    return _Way(lambda figure: renderer.draw(scene(figure)), nbytes, lambda figure: renderer.draw_unread(scene(figure)))


def _by_maps(peers: ReliefRenderer, method: str, maps: Mapping[str, ReliefMaps]) -> _Way:
    return _Way(
        lambda figure: peers.draw(method, figure, maps),
        sum(each.nbytes for each in maps.values()),
        lambda figure: peers.draw_unread(method, figure, maps),
    )


def _times(figure: FigureScene, ways: Mapping[str, _Way], renderer: str, frames: int) -> dict[str, float]:
    """Median time in seconds of a frame by each way, frames having taken turns."""
    # What else runs delays long frames more than short ones; a software rasteriser's own time does not know of it.
    clock = time.process_time if "llvmpipe" in renderer else time.perf_counter
    frame = {method: way.draw_unread for method, way in ways.items() if way.draw_unread is not None}
    spent: dict[str, list[float]] = {method: [] for method in frame}
    for _ in range(WARM + frames):
        for method, draw in frame.items():
            begun_s = clock()
            draw(figure)
            spent[method].append(clock() - begun_s)
    return {method: float(np.median(each[WARM:])) for method, each in spent.items()}
