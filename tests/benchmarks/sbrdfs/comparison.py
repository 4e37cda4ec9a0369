"""Representations of the same BTFs at several sizes: error against truth, bytes, time to make and to draw.

Five ray-traced samples, two in the short form; all methods see the same noisy values, errors are against the true
ones, with the cosine inside, over the mean square of the truth. Linear methods are in half floats (`btf_methods`).
Rows with a `parameter` are error over bytes for each sample, and error over the view's polar angle, the median of the
samples, of the size of each family that is nearest to that of SBRDF+; others have error over time.

`svd_over_eckart_young`: error of the streamed SVD of texels over the least that its rank allows, both as roots, the
worst over samples and ranks.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from processing.products import Btf
from processing.svd import TexelFactors
from render.errors import GlUnavailableError
from render.opengl import GlRenderer
from render.scene import Scene, framed, light
from render.shapes import sphere
from service.bench import Result
from tests.benchmarks.yardsticks import btf_methods as methods
from tests.benchmarks.yardsticks.btf_errors import BtfErrors, btf_errors
from tests.benchmarks.yardsticks.btf_methods import Given, Represented
from tests.benchmarks.yardsticks.btf_samples import SAMPLES, BtfWithTruth, quick_directions, ray_traced
from tests.benchmarks.yardsticks.lobe_methods import analysed, sixteen_floats
from tests.benchmarks.yardsticks.material_samples import bonn_directions
from tests.render import synthetic

SEED = 1
FULL_SIZE = ("pipe",)  # at 64 x 64 texels; the others at 32 x 32
QUICK_SAMPLES = ("brick", "pipe")
RANKS, VIEW_RANKS = (1, 2, 4, 8, 16, 32, methods.MOST_TERMS), (1, 2, 4)
CLUSTERS = ((2, 2), (4, 2), (4, 4), (8, 4), (4, 8))  # and terms for each
QUICK_RANKS, QUICK_VIEW_RANKS, QUICK_CLUSTERS = (1, 4, 16), (1, 2), ((2, 2), (4, 4))
OURS = ("SRF", "SBRDF", "STVS", "SBRDF+")
DRAWN = ("pipe",)  # of which frames are timed
FRAME, WARM, FRAMES = (300, 300), 3, 15
Row = dict[str, Any]


def run(*, quick: bool) -> Result:
    """All methods on all samples; quick on 16 x 16 texels and 19 x 19 directions, without most of the sizes."""
    compare(data_set("brick", 8, quick_directions()), quick=True)  # compiles
    rows, ratios = [], []
    for data in data_sets(quick=quick):
        found, given = compare(data, quick=quick)
        rows += found
        ratios += over_eckart_young(given, QUICK_RANKS if quick else RANKS)
    figures = {"svd_over_eckart_young": max(ratios)}
    spread = {"figure": "svd_over_eckart_young", "median": float(np.median(ratios)), "least": min(ratios)}
    return Result(figures, [*rows, *over_bytes(rows), *over_rings(rows), *over_time(rows), spread])


def data_sets(*, quick: bool) -> Iterator[BtfWithTruth]:
    """One after another: those of full size take 0.7 GB each."""
    if quick:
        yield from (data_set(sample, 16, quick_directions()) for sample in QUICK_SAMPLES)
        return
    for sample in SAMPLES:
        yield data_set(sample, 64 if sample in FULL_SIZE else 32, bonn_directions())


def data_set(sample: str, texels: int, directions: np.ndarray) -> BtfWithTruth:
    """A sample of the benchmark's seed."""
    return ray_traced(sample, texels, SEED, directions, directions)


def compare(data: BtfWithTruth, *, quick: bool) -> tuple[list[Row], Given]:
    """A row for each method at each of its sizes, and what they were made from."""
    given = Given(data.btf)
    lobes = [methods.srf(given), sixteen_floats(given), *analysed(given)]
    made = [*_linear(given, lobes[-1].size_bytes, quick=quick), *lobes]
    drawn = frames(made, 3 if quick else FRAMES) if data.name in DRAWN else [{}] * len(made)
    raw = methods.HALF_BYTES * data.btf.reflectance.size
    rows = [
        _row(one, btf_errors(one.seen_from, data.true, 1 if quick else 3))
        | {"sample": data.name, "raw_over_bytes": raw / one.size_bytes, **frame}
        for one, frame in zip(made, drawn, strict=True)
    ]
    return rows, given


def _linear(given: Given, size_bytes: int, *, quick: bool) -> Iterator[Represented]:
    """Those without lobes but one; an SVD as large as the given size among them."""
    as_large = round(size_bytes / (methods.HALF_BYTES * given.values_per_term))
    yield methods.phong(given)
    yield from methods.svd(given, sorted({*(QUICK_RANKS if quick else RANKS), min(as_large, given.most_terms)}))
    yield from methods.svd_by_views(given, QUICK_VIEW_RANKS if quick else VIEW_RANKS)
    yield from methods.clustered(given, QUICK_CLUSTERS if quick else CLUSTERS)
    yield methods.ptm(given)
    yield methods.ptm_per_view(given)


def _row(one: Represented, errors: BtfErrors) -> Row:
    return {
        "method": one.method, "parameters": one.size, "bytes": one.size_bytes, "seconds": one.seconds,
        "mse": errors.mse, "relative_mse": errors.relative, **errors.spread(), "rings": errors.rings,
        "flip": errors.flip, "ssim": errors.ssim, "peer": one.method not in OURS,
    }  # fmt: skip


def frames(made: Sequence[Represented], count: int) -> list[Row]:
    """Frames of a sphere under one light: medians in seconds and over a flat texture's, which took turns with them."""
    try:
        renderer = GlRenderer()
    except GlUnavailableError as error:
        return [{"missing_frame": str(error)}] * len(made)
    try:
        return [_frame(renderer, one.drawn, count) for one in made]
    finally:
        renderer.release()


def _frame(renderer: GlRenderer, material: Any, count: int) -> Row:
    if isinstance(material, str):
        return {"missing_frame": material}
    mesh = sphere(shape=(65, 125))
    camera = framed(mesh, FRAME, azimuth_rad=np.radians(-35.0), elevation_rad=np.radians(35.0))
    lights = (light(np.radians(-35.0), np.radians(40.0)),)
    scenes = [Scene.of(mesh, one, camera, lights) for one in (synthetic.pattern(64), material)]
    seconds = np.empty((WARM + count, 2))
    for turn, which in np.ndindex(seconds.shape):
        begun_s = time.perf_counter()
        renderer.draw_unread(scenes[which])
        seconds[turn, which] = time.perf_counter() - begun_s
    flat_s, frame_s = np.median(seconds[WARM:], axis=0)
    return {"frame_s": float(frame_s), "frame_over_flat": float(frame_s / flat_s), "renderer": renderer.name}


def over_eckart_young(given: Given, ranks: Sequence[int]) -> list[float]:
    """Error of the streamed SVD of texels over the least that each rank allows, of the values that it was given."""
    squares, (factors, _) = given.strongest, given.factors
    return [float(np.sqrt(_squared_error(factors, given.cosine, rank) / squares[rank:].sum())) for rank in ranks]


def _squared_error(factors: TexelFactors, btf: Btf, rank: int) -> float:
    total = 0.0
    for view in range(btf.shape[1]):
        drawn = np.tensordot(factors.functions[:rank, :, view], factors.maps[:rank], (0, 0)).transpose(0, 2, 3, 1)
        total += float(np.square(btf.seen_from(view) - drawn, dtype=np.float64).sum())
    return total


def over_bytes(rows: Sequence[Row]) -> list[Row]:
    """Error over size, a picture for each sample."""
    return [
        {"method": row["method"], "parameter": f"bytes, {row['sample']}", "value": row["bytes"], **_drawn(row)}
        for row in sorted(rows, key=lambda row: float(row["bytes"])) if row["bytes"] > 1000
    ]  # fmt: skip


def over_rings(rows: Sequence[Row]) -> list[Row]:
    """Error over the view's polar angle, the median of the samples, of each method where it is as large as SBRDF+."""
    alike = as_large(rows)
    found = []
    for method, same in alike.items():
        for polar in same[0]["rings"]:
            error = float(np.median([row["rings"][polar] for row in same]))
            found.append({"method": method, "parameter": "polar angle of the view in degrees", "value": polar,
                          **_drawn(same[0]), "error": error})  # fmt: skip
    return found


def over_time(rows: Sequence[Row]) -> list[Row]:
    """Error over the time to make it, of each method where it is as large as SBRDF+."""
    return [
        {"method": method, "size": row["sample"], "seconds": row["seconds"], **_drawn(row)}
        for method, same in as_large(rows).items() for row in same
    ]  # fmt: skip


def as_large(rows: Sequence[Row]) -> Mapping[str, list[Row]]:
    """For each method a row of each sample: the one whose bytes are nearest to those of SBRDF+, as ratios."""
    target = {row["sample"]: row["bytes"] for row in rows if row["method"] == "SBRDF+"}
    found: dict[str, list[Row]] = {}
    for method in dict.fromkeys(row["method"] for row in rows):
        for sample, size in target.items():
            own = [row for row in rows if (row["method"], row["sample"]) == (method, sample)]
            found.setdefault(method, []).append(min(own, key=lambda row: abs(np.log(row["bytes"] / size))))
    return found


def _drawn(row: Row) -> Row:
    return {"error": row["relative_mse"], "unit": "mean squares of the truth", "peer": row["peer"]}
