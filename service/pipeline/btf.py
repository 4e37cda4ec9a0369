"""The BTF of a flat sample, its factors and its SBRDF+, from a `btf` session."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from processing import geometry
from processing.cameras.rectification import Texels, rectify
from processing.cameras.white_frame import WhiteFrame, reflectance, white_frame_radiance
from processing.products import Btf, FactoredBtf, Provenance, StoredBtf
from processing.svd import factor_btf
from rig.config import RigConfig, SampleHolder
from rig.sessions import BtfPlan, Session
from service.pipeline.calibrations import Calibrations
from service.pipeline.inputs import Progress, fingerprint, is_current, provenance
from service.pipeline.sbrdf import make_sbrdf_plus
from service.pipeline.stacks import Stack, light_direction, merge, stacks

Array = NDArray[np.float64]
PRODUCTS = ("btf", "factored_btf", "sbrdf_plus")


def make_btf(session: Session, calibrations: Calibrations, progress: Progress, rank: int) -> list[Path]:
    """The BTF on the sample's texels, its factors, and where its directions can carry that its SBRDF+."""
    folder, factored, plus = (session.products / name for name in PRODUCTS)
    records = session.frames()
    grid = texels_of(session)
    measured_on = {"texels": grid.count} | ({"depth_m": grid.depth_m} if grid.depth_m else {})
    inputs = fingerprint(records, {**measured_on, "calibrations": calibrations.digest()})
    if not is_current(folder, inputs):
        _btf(session, calibrations, progress, provenance(session, inputs)).save(folder)
    made_from = inputs | {"rank": rank, "errors": "times the cosine"}
    if not is_current(factored, made_from):
        source = provenance(session, made_from)
        factors = factor_btf(StoredBtf.open(folder), rank).btf
        FactoredBtf(factors.eigenmaps, factors.weights, factors.lights, factors.views, source).save(factored)
    analysable = is_current(plus, inputs) or make_sbrdf_plus(folder, plus, provenance(session, inputs), progress)
    return [folder, factored, plus] if analysable else [folder, factored]


@dataclass(frozen=True, eq=False)
class BtfLayout:
    """Directions of a BTF, and for each stack its place (light, view) in it."""

    light_directions: Array
    view_directions: Array
    places: tuple[tuple[int, int], ...]


def btf_layout(gathered: Sequence[Stack], config: RigConfig, calibrations: Calibrations) -> BtfLayout:
    """Which light and view each stack is, lights and views in the order in which they first appear."""
    lights, views = _Directions(), _Directions()
    places = []
    for stack in gathered:
        rig_from_sample = geometry.rotation_z(stack.step.axes_rad["turntable"])
        towards = geometry.rotate(geometry.invert(rig_from_sample), calibrations.camera(stack.camera).centre_m)
        places.append((lights.index(light_direction(config, stack.step, calibrations)), views.index(towards)))
    return BtfLayout(np.stack(lights.found), np.stack(views.found), tuple(places))


def _btf(session: Session, calibrations: Calibrations, progress: Progress, source: Provenance) -> Btf:
    gathered, grid = stacks(session.frames()), texels_of(session)
    layout = btf_layout(gathered, session.config, calibrations)
    shape = (len(layout.light_directions), len(layout.view_directions), grid.count, grid.count, 3)
    btf = np.full(shape, np.nan, np.float32)
    for number, stack in enumerate(progress.track(gathered, "merging and rectifying")):
        btf[layout.places[number]] = _image(stack, calibrations, session.config.holder, grid)
    return Btf(btf, layout.light_directions, layout.view_directions, source)


def texels_of(session: Session) -> Texels:
    """The texels of a `btf` session; where they lie under the opening, its edge is a rim before them."""
    assert isinstance(session.plan, BtfPlan)
    holder, depth_m = session.config.holder, session.plan.depth_mm / 1e3
    opening_m = holder.sample_mm / 1e3
    return Texels(session.plan.texels, holder.texels_mm / 1e3, opening_m, rim_m=depth_m, depth_m=depth_m)


def _image(stack: Stack, calibrations: Calibrations, holder: SampleHolder, grid: Texels) -> NDArray[np.float32]:
    """Reflectance (y, x, channel) of the sample in one view under one light."""
    frame = WhiteFrame(holder.sample_mm / 1e3, holder.inner_mm / 1e3)
    rig_from_sample = geometry.rotation_z(stack.step.axes_rad["turntable"])
    camera, merged = calibrations.camera(stack.camera), merge(stack, calibrations)
    seen = rectify(merged.radiance, camera, rig_from_sample, grid, merged.cfa)
    white = white_frame_radiance(merged.radiance, camera, rig_from_sample, frame, merged.cfa)
    return reflectance(seen, white, holder.white_reflectance).value


class _Directions:
    """Unit directions in the order in which they first appear; closer than a thousandth of a degree are one."""

    def __init__(self) -> None:
        self.found: list[Array] = []

    def index(self, towards: Array) -> int:
        direction = towards / np.linalg.norm(towards)
        for number, known in enumerate(self.found):
            if float(direction @ known) > 1 - 1e-10:
                return number
        self.found.append(direction)
        return len(self.found) - 1
