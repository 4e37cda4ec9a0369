"""SBRDF, STVS and SBRDF+ among the representations of `btf_methods`: what each sees, its bytes and its time."""

from collections.abc import Iterator

import numpy as np

from processing.products import LafortuneTexels
from processing.sbrdf.analysis import SbrdfAnalysis, analyse
from processing.sbrdf.drawn import DrawnLobes, DrawnPlus
from processing.sbrdf.lafortune import LafortuneFit, LobeLayout, fit_lafortune
from tests.benchmarks.yardsticks.btf_methods import NOT_DRAWN, Given, Represented, timed


def sixteen_floats(given: Given) -> Represented:
    """The paper's layout: three lobes with one C and a grey diffuse."""
    lobes, seconds = timed(lambda: _fitted(given, LobeLayout.SHARED))
    return _sbrdf(given, lobes, seconds)


def analysed(given: Given) -> Iterator[Represented]:
    """SBRDF of 24 floats, STVS, and SBRDF+ as it is packed."""
    found = analyse(given.btf)
    yield _sbrdf(given, found.sbrdf, found.seconds["lobes"])
    yield _stvs(given, found)
    packed = found.product.quantised()
    seconds = sum(found.seconds.values())
    yield Represented("SBRDF+", "24 floats", DrawnPlus(packed).seen_from, packed.size_bytes, seconds, packed)


def _sbrdf(given: Given, lobes: LafortuneTexels, seconds: float) -> Represented:
    seen = DrawnLobes(lobes, given.btf.light_directions, given.btf.view_directions).seen_from
    size = lobes.packed().nbytes
    return Represented("SBRDF", f"{size // (4 * given.texels)} floats", seen, size, seconds)


def _stvs(given: Given, found: SbrdfAnalysis) -> Represented:
    shadow = np.rint(found.stvs.shadow * 255) / np.float32(255)  # a byte each
    directions = given.btf.light_directions, given.btf.view_directions
    seen = DrawnLobes(found.stvs.lobes, *directions, shadow).seen_from
    seconds = found.seconds["lobes"] + found.seconds["shadows"]
    size = found.stvs.lobes.packed().nbytes + shadow.size
    return Represented("STVS", "24 floats, a byte per light", seen, size, seconds, NOT_DRAWN)


def _fitted(given: Given, layout: LobeLayout) -> LafortuneTexels:
    light, view = given.samples.pairs()
    spans = given.samples.row_spans()
    fits = [fit_lafortune(given.samples.texels(rows), light, view, layout=layout) for rows in spans]
    return LafortuneFit.joined(fits).texels(*given.btf.shape[2:4], given.samples.scale)
