"""SBRDF+ of a flat sample: its BTF analysed at all its texels and at the coarser levels."""

from dataclasses import replace
from math import degrees
from pathlib import Path

import numpy as np

from processing.errors import ImageError
from processing.products import Btf, DirectionMesh, Provenance
from processing.sbrdf.analysis import SbrdfAnalysis, analyse
from processing.sbrdf.levels import coarser_levels
from processing.sbrdf.samples import BtfViews, Samples
from service.pipeline.inputs import Progress

FEWEST_PAIRS = 256  # of a light and a view: of fewer, lobes and shadows are a guess between them, and it shows
FARTHEST_TOP_DEG = 25.0  # from the normal, of the view that stands for the one from the top


def make_sbrdf_plus(btf: Path, folder: Path, source: Provenance, progress: Progress) -> bool:
    """Analyse the BTF in a product folder into another one; False, and told, where it cannot carry that."""
    measured = Btf.load(btf)
    try:
        check_analysable(measured)
        _check_pairs(measured)
    except ImageError as error:
        progress.note(f"no SBRDF+: {error}")
        return False
    replace(analysed(measured, progress).product, provenance=source).save(folder)
    return True


def analysed(btf: BtfViews, progress: Progress) -> SbrdfAnalysis:
    """The analysis of a BTF whose product has its coarser levels."""
    found = analyse(btf, report=progress)
    levels = coarser_levels(btf, lambda level: analyse(level, report=progress).product)
    return replace(found, product=replace(found.product, coarser=levels))


def check_analysable(btf: BtfViews) -> None:
    """Raises ImageError that names what lights, views and values of a BTF lack for an analysis."""
    for name, directions in (("lights", btf.light_directions), ("views", btf.view_directions)):
        try:
            DirectionMesh.from_directions(directions)
        except ImageError as error:
            raise ImageError(
                f"the {len(directions)} {name} do not span an area: three or more, not on a line"
            ) from error
    top = Samples(btf, 1.0).top
    angle_deg = degrees(np.arccos(np.clip(btf.view_directions[top, 2], -1, 1)))
    if angle_deg > FARTHEST_TOP_DEG:
        raise ImageError(f"the highest view is {angle_deg:.0f} deg from the normal, more than {FARTHEST_TOP_DEG:g}")
    if not np.isfinite(btf.seen_from(top)).any():
        raise ImageError("the view from the top has no measured value")


def _check_pairs(btf: BtfViews) -> None:
    lights, views = btf.shape[:2]
    if lights * views < FEWEST_PAIRS:
        raise ImageError(
            f"{lights} lights x {views} views are too few, {FEWEST_PAIRS} pairs are wanted; rig analyse tries"
        )
