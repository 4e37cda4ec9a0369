"""From btf and mdf sessions on the simulated rig, through wires, frames and analysis, to a torus beside its truth.

The woven sample's period is the square of the texels, so that what was measured repeats as the truth does. Board, BTF
and MDF are captured and processed as a person would; quick with few views, lights and sweeps, and in one texture scale.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import TypeVar

import numpy as np

from processing.products import Mesostructure
from processing.svd import Colour
from render.materials import Material
from render.picture import Picture
from render.preview import Preview
from rig.config import load_config
from rig.sessions import Plan, Session, load_plan, parse_plan, plan_data
from service.bench import Result
from service.capture import capture
from service.demo import PLANS
from service.joining import join_sessions
from service.pipeline import process
from service.simulation import Simulation
from tests.benchmarks.yardsticks.bands import flip_map, mask_iou, silhouette_band
from tests.benchmarks.yardsticks.displaced import Covered, Displaced, TruePicture
from tests.benchmarks.yardsticks.figure_scenes import FigureScene, torus_scene
from tests.benchmarks.yardsticks.mesostructures import mesostructure
from tests.benchmarks.yardsticks.sample_periods import period

Item = TypeVar("Item")

SAMPLE, SEED = "weave", 1
TILES, QUICK_TILES = ((6, 2), (3, 1)), ((6, 2),)  # the first is the figure's
SIZE, QUICK_SIZE = (800, 600), (240, 180)
_TERMS: tuple[int, Colour] = (8, "colour")
_CAMERAS = {"cameras": ["cam0", "cam7"]}
_FEW = _CAMERAS | {"turntable_deg": [0, 120, -120], "texels": 24}
_QUICK = {
    "calibrate": _CAMERAS | {"board_poses": 4, "turntable_deg": [-90, 90]},
    "btf": _FEW | {"light_azimuth_deg": [60, 180, -60], "lamps": ["lamp2", "lamp6"], "exposures_s": [0.04]},
    "mdf": _FEW | {
        "laser_azimuth_deg": [90, -90], "laser_elevations_deg": [50], "exposure_s": 0.05, "frame_rate_hz": 5.0,
    },
}  # fmt: skip


class Silent:
    """Nobody watches."""

    def track(self, items: Iterable[Item], description: str) -> Iterator[Item]:
        """The items."""
        yield from items

    def note(self, text: str) -> None:
        """Is not told."""


def run(*, quick: bool) -> Result:
    """Sessions, products and pictures; a row for each texture scale, in full also for a perfect capture."""
    with TemporaryDirectory() as folder:
        started = perf_counter()
        measured = captured(Path(folder), plans(quick=quick))
        seconds = perf_counter() - started
    rows = [row for tiles in (QUICK_TILES if quick else TILES) for row in compared(measured, tiles, quick=quick)]
    by_figure = next(row for row in rows if row["method"] == "rig: BTF + MDF")
    rows.append({"step": "sessions, calibration and products", "seconds": seconds})
    return Result({"endtoend_band_flip_over_plain": float(by_figure["over_plain"])}, rows)


def plans(*, quick: bool) -> dict[str, Plan]:
    """Board, BTF and MDF, in the order in which they are taken."""
    files = {"calibrate": "calibrate", "btf": f"btf-{SAMPLE}", "mdf": f"mdf-{SAMPLE}"}
    found = {kind: load_plan(PLANS / f"{name}.toml") for kind, name in files.items()}
    return {kind: parse_plan(plan_data(plan) | _QUICK[kind]) for kind, plan in found.items()} if quick else found


def captured(folder: Path, planned: dict[str, Plan]) -> Mesostructure:
    """The material of sessions that are captured and processed in the folder."""
    with Simulation(folder / "simulation", seed=SEED) as simulation:
        config = load_config(simulation.rig_toml)
        for kind, plan in planned.items():
            capture(plan, config, folder / kind, operator=simulation.mount, on_event=lambda event: None)
    for kind in planned:
        with Session.open(folder / kind) as session:
            process(session, [] if kind == "calibrate" else [folder / "calibrate"], Silent())
    list(join_sessions(folder / "btf", folder / "mdf", folder / SAMPLE))
    return Mesostructure.load(folder / SAMPLE)


def compared(measured: Mesostructure, tiles: tuple[int, int], *, quick: bool) -> list[dict[str, object]]:
    """A torus in one texture scale: errors of BTF and BTF + MDF from the rig, in full also from a perfect capture."""
    figure = torus_scene(tiles, QUICK_SIZE if quick else SIZE, SAMPLE)
    bodies = [Covered(body.surface, body.tiles, period(SAMPLE, SEED)) for body in figure.bodies]
    true = Displaced(bodies).seen(figure.camera, figure.lights, 2 if quick else 4)
    directions = measured.btf.lights.directions, measured.btf.views.directions
    sources = {"rig": measured}
    if not quick:
        made = mesostructure(SAMPLE, SEED, measured.depths.shape[1], *directions, _TERMS[0], colour=_TERMS[1])
        sources["perfect capture"] = replace(made, btf=made.btf.coded(np.uint8))
    rows = []
    for source, material in sources.items():
        plain = judged(true, drawn(figure, material.btf))
        relief = judged(true, drawn(figure, material))
        about = {"tiles": tiles, "source": source}
        rows += [
            about | {"method": f"{source}: BTF"} | plain,
            about | {"method": f"{source}: BTF + MDF"} | relief | {"over_plain": relief["flip"] / plain["flip"]},
        ]
    return rows


def drawn(figure: FigureScene, material: Material) -> Picture:
    """The figure's picture with one material on all bodies."""
    with Preview(figure.camera.size) as preview:
        return preview.draw(figure.scene(dict.fromkeys(figure.samples, material)))


def judged(true: TruePicture, picture: Picture) -> dict[str, float]:
    """FLIP in the band along the silhouettes, and how far the masks agree."""
    band = silhouette_band(true)
    return {"flip": float(np.mean(flip_map(true.picture, picture)[band])), "iou": mask_iou(true.picture, picture)}
