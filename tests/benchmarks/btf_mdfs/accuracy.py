"""Silhouettes, parallax and shadows against the truth: the samples' own surfaces bent around bodies, ray-traced.

Plain BTF (with an ordinary shadow map of the bodies' meshes) and BTF with depths are drawn by the same renderer, from
the same noise-free factors, eight coloured terms in bytes as `rig join` keeps, and averaged over as many samples to a
pixel as the truth; meshes are fine enough for facets not to count. A plain BTF on a mesh lowered to the plane of the
texels tells how much of a gain is where the surface lies on the whole, and how much its relief. Mitsuba draws the same
triangles as a referee of the truth.

A row is one method on one scene: `band_flip` is the mean of FLIP within 8 px of the true silhouette, `band_quartiles`
its spread; `iou` compares masks; `shadow_edge_flip` is FLIP within 8 px of the edges of shadows from afar. Figures are
of the worst scene, for it alone: of masks the one where least of the gap is closed.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from processing.products import FactoredBtf, Mesostructure
from processing.svd import Colour
from render.camera import look_at
from render.mesh import grid_mesh
from render.opengl import GlRenderer
from render.picture import Picture
from render.scene import light
from render.shapes import placed, plane_surface, torus_surface
from render.wrapping import wrapping
from service.bench import Result
from tests.benchmarks.yardsticks.bands import flip_map, mask_iou, shadow_band, silhouette_band
from tests.benchmarks.yardsticks.covered import Covered
from tests.benchmarks.yardsticks.displaced import Displaced, TruePicture
from tests.benchmarks.yardsticks.figure_scenes import (
    TORUS_TILES,
    CoveredMesh,
    FigureScene,
    cylinder_scene,
    knot_scene,
    torus_scene,
)
from tests.benchmarks.yardsticks.mesostructures import mesostructure, polar_grid
from tests.benchmarks.yardsticks.mitsuba_displaced import matt, rendered
from tests.benchmarks.yardsticks.sample_periods import period

SEED = 1
SIZE, QUICK_SIZE = (800, 600), (240, 180)
SAMPLES = ("brick", "weave")
SUPERSAMPLING = 2
PLAIN, LOWERED, OURS = "plain BTF", "plain BTF on a lower mesh", "BTF with depths"
_FINE = (72, 256)  # quads of a body's mesh
Row = dict[str, Any]


@dataclass(frozen=True)
class Measured:
    """How a sample is measured and kept: texels along a side, rays to a texel, directions, terms, in bytes."""

    texels: int
    rays: int
    lights: tuple[float, ...]  # polar angles in degrees
    views: tuple[float, ...]
    azimuths: int = 12
    rank: int = 8
    colour: Colour = "colour"

    @property
    def terms(self) -> str:
        """How many of which kind."""
        return f"{self.rank} {self.colour}"

    def of(self, sample: str) -> Mesostructure:
        """The sample, kept for the next who asks for the same."""
        ways = (polar_grid(self.azimuths, polar) for polar in (self.lights, self.views))
        made = mesostructure(sample, SEED, self.texels, *ways, self.rank, self.rays, self.colour)
        return replace(made, btf=made.btf.coded(np.uint8))


FULL = Measured(64, 1, (15.0, 30.0, 45.0, 60.0, 75.0), (15.0, 30.0, 45.0, 60.0, 75.0))
QUICK = Measured(32, 1, (25.0, 50.0, 70.0), (25.0, 50.0, 75.0), azimuths=8)
# What is varied on the torus of 3 x 1 tiles of brick. Four coloured terms have the bytes of twelve grey ones.
VARIED = {
    "terms": [
        *(replace(FULL, rank=rank) for rank in (4, 8, 12)),
        *(replace(FULL, rank=rank, colour="grey") for rank in (4, 12, 24)),
    ],
    "lowest view in degrees from the normal": [replace(FULL, views=FULL.views[:kept]) for kept in (3, 4, 5)],
}


def run(*, quick: bool) -> Result:
    """All scenes; quick two of them, smaller."""
    renderer = GlRenderer()
    try:
        rows = [row for name, figure in scenes(quick=quick) for row in judged(renderer, name, figure, quick=quick)]
        more = [] if quick else [*variations(renderer), referee()]
    finally:
        renderer.release()
    return Result(figures(rows), [*rows, *medians(rows), *more])


def scenes(*, quick: bool) -> Iterator[tuple[str, FigureScene]]:
    """Names and scenes, each of one sample; those with a floor are for shadows."""
    size = QUICK_SIZE if quick else SIZE
    for sample in SAMPLES[:1] if quick else SAMPLES:
        for tiles in ((3, 1),) if quick else TORUS_TILES:
            yield f"torus {tiles[0]} x {tiles[1]}", _fine(torus_scene(tiles, size, sample))
        yield "torus on a floor", torus_on_floor(size, sample)
        if not quick:
            yield "cylinder", cylinder_scene(size, sample)
    if not quick:
        yield "knot", _fine(knot_scene(size, "weave"))


def torus_on_floor(size: tuple[int, int], sample: str) -> FigureScene:
    """A torus over a floor that fills the picture, and its shadow beside it."""
    above = np.eye(4)
    above[2, 3] = 0.9
    bodies = (
        CoveredMesh(grid_mesh(plane_surface(8.0), (2, 2), (3, 3)), plane_surface(8.0), (3, 3), sample),
        CoveredMesh(grid_mesh(ring := placed(torus_surface(), above), _FINE, (3, 1)), ring, (3, 1), sample),
    )
    camera = look_at([4.0, -2.5, 7.5], [-0.3, 0.0, 0.4], size, field_of_view_rad=0.34)
    return FigureScene(bodies, camera, (light(np.radians(20.0), np.radians(45.0), 3.0),))


def judged(renderer: GlRenderer, name: str, figure: FigureScene, *, quick: bool) -> Iterator[Row]:
    """A row for each method on a scene."""
    true = truth(figure)
    yield from compared(renderer, (name, figure, true), QUICK if quick else FULL)


def truth(figure: FigureScene) -> TruePicture:
    """The scene with its samples' own surfaces."""
    bodies = [Covered(body.surface, body.tiles, period(body.sample, SEED)) for body in figure.bodies]
    return Displaced(bodies).seen(figure.camera, figure.lights, SUPERSAMPLING)


def compared(renderer: GlRenderer, case: tuple[str, FigureScene, TruePicture], measured: Measured) -> Iterator[Row]:
    """A row for each method, of samples measured in one way."""
    name, figure, true = case
    structures = {sample: measured.of(sample) for sample in figure.samples}
    plain = {sample: structure.btf for sample, structure in structures.items()}
    ways = ((PLAIN, figure, plain), (LOWERED, lowered(figure, structures), plain), (OURS, figure, structures))
    for method, bodies, materials in ways:
        row = errors(true, drawn(renderer, bodies, materials), alone=len(figure.bodies) == 1)
        told = {"method": method, "scene": name, "sample": figure.bodies[0].sample, "terms": measured.terms}
        yield {**told, "peer": method != OURS, **row}


def lowered(figure: FigureScene, structures: Mapping[str, Mesostructure]) -> FigureScene:
    """The scene with its meshes on the plane of the texels, where a BTF without depths does best."""

    def lower(body: CoveredMesh) -> CoveredMesh:
        scale = np.sqrt(wrapping(body.mesh).stretch.prod(axis=1, keepdims=True))
        down = structures[body.sample].plane * scale * body.mesh.normals
        return replace(body, mesh=replace(body.mesh, positions=body.mesh.positions - down))

    return replace(figure, bodies=tuple(map(lower, figure.bodies)))


def drawn(
    renderer: GlRenderer, figure: FigureScene, materials: Mapping[str, FactoredBtf] | Mapping[str, Mesostructure]
) -> Picture:
    """The scene with shadows, as many samples to a pixel as the truth."""
    scene = replace(figure.scene(materials), camera=figure.camera.scaled(SUPERSAMPLING), shadows=True)
    return renderer.draw(scene).averaged(SUPERSAMPLING)


def errors(true: TruePicture, picture: Picture, *, alone: bool) -> Row:
    """FLIP in the bands and on the rest of the bodies, and masks where nothing is behind them."""
    flip, band, edge = flip_map(true.picture, picture), silhouette_band(true), shadow_band(true)
    rest = flip[(true.picture.coverage > 0.99) & ~band]
    row: Row = {
        "band_flip": float(flip[band].mean()),
        "band_quartiles": [round(float(value), 4) for value in np.percentile(flip[band], (25, 50, 75))],
        "rest_flip": float(rest.mean()),
    }
    if edge.any():
        row |= {"shadow_edge_flip": float(flip[edge].mean()), "shadow_edge_px": int(edge.sum())}
    return row | {"iou": mask_iou(true.picture, picture)} if alone else row


def variations(renderer: GlRenderer) -> Iterator[Row]:
    """Band error over what is varied, on the torus of 3 x 1 tiles, and over its texture scale."""
    figure = _fine(torus_scene((3, 1), SIZE, "brick"))
    case = ("torus 3 x 1", figure, truth(figure))
    for parameter, settings in VARIED.items():
        for measured in settings:
            value = measured.rank if parameter == "terms" else max(measured.views)
            for row in compared(renderer, case, measured):
                method = row["method"] + (", coloured" if measured.colour == "colour" else "")
                yield row | {"method": method, "parameter": parameter, "value": value,
                             "error": row["band_flip"], "unit": "FLIP"}  # fmt: skip


def referee() -> Row:
    """How far Mitsuba is from the truth on one scene, of a sample without gloss."""
    figure = torus_scene((3, 1), QUICK_SIZE, "weave")
    displaced = Displaced(
        [matt(Covered(body.surface, body.tiles, period(body.sample, SEED))) for body in figure.bodies]
    )
    true = displaced.seen(figure.camera, figure.lights, 8)
    told = {"method": "Mitsuba", "scene": "torus 3 x 1", "sample": "weave, matt", "peer": True}
    try:
        return {**told, **errors(true, rendered(displaced, figure.camera, figure.lights[0], 64), alone=True)}
    except ImportError:
        return {**told, "missing": "mitsuba is not installed"}


def figures(rows: Sequence[Row]) -> dict[str, float]:
    """The worst ratios, and the masks of the scene where least of the gap to the truth is closed."""
    pairs = list(zip(rows[::3], rows[2::3], strict=True))
    masks = [(plain["iou"], ours["iou"]) for plain, ours in pairs if "iou" in plain]
    plain_iou, ours_iou = min(masks, key=lambda pair: (pair[1] - pair[0]) / (1.0 - pair[0]))
    shadows = [
        ours["shadow_edge_flip"] / plain["shadow_edge_flip"] for plain, ours in pairs if "shadow_edge_flip" in plain
    ]
    return {
        "band_flip_over_plain": max(ours["band_flip"] / plain["band_flip"] for plain, ours in pairs if "iou" in plain),
        "mask_iou_plain": plain_iou,
        "mask_iou_ours": ours_iou,
        "shadow_edge_flip_over_plain": max(shadows),
    }


def medians(rows: Sequence[Row]) -> Iterator[Row]:
    """Of the scenes with nothing behind: band error over that of each plain method, the median and all of them."""
    for start, rival in enumerate((PLAIN, LOWERED)):
        pairs = zip(rows[start::3], rows[2::3], strict=True)
        ratios = [ours["band_flip"] / other["band_flip"] for other, ours in pairs if "iou" in ours]
        told = {"figure": "band_flip_over_plain", "over": rival, "median": float(np.median(ratios))}
        yield {**told, "scenes": [round(ratio, 4) for ratio in ratios]}


def _fine(figure: FigureScene) -> FigureScene:
    """The same scene, its meshes so fine that their facets do not count."""
    bodies = (replace(body, mesh=grid_mesh(body.surface, _FINE, body.tiles)) for body in figure.bodies)
    return replace(figure, bodies=tuple(bodies))
