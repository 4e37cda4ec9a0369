"""Factors of BTFs: their error beside the least one, time and memory in core and out of core, bytes, frames by coding.

`svd_rank4_relative_mse` is the squared error of four coloured terms over the sum of squares, of the worst sample, both
times the light's cosine squared; rows have every sample with coloured and grey maps of more terms and in fewer bits.
`svd_out_of_core_rate` is the time of factors of a BTF that lies in memory over that of the same BTF read from its store
in both passes, both on the clock: works take turns after one that warms files and threads, and the figure is the median
of the turns' quotients; a row has the time to load it added to the numerator. `svd_peak_memory_ratio` is what streaming
allocates, its result among it, over the BTF as float32. `eigenmap_bytes` are of four grey terms of bytes at 64 x 64
texels and 12 x 5 lights and views, as is `mdf_bytes`; rows have the paper's three layouts. Its own sizes do not follow
from them: four eigenmaps of three bytes a texel are 2.95, 18.9 and 4.72 MB, not 1.3, 7.5 and 5.3, and bytes of the MDF
0.25, 1.57 and 0.39, not 0.9, 6.3 and 3.9.
"""

import time
import tracemalloc
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.products import Btf, DirectionMesh, FactoredBtf, StoredBtf
from processing.svd import factor_btf
from render.errors import GlUnavailableError
from render.opengl import GlRenderer
from render.scene import Scene, framed, light
from render.shapes import torus
from service.bench import Result
from service.truth import factored_error
from simulators.far_field import btf_below
from tests.benchmarks.yardsticks.btf_samples import PLANES_M, SAMPLES
from tests.benchmarks.yardsticks.material_samples import rings
from tests.reference.btf import eckart_young

Array = NDArray[Any]
Row = dict[str, object]
SEED = 1
RANK = 4
QUICK_SAMPLES = ("brick", "pipe")  # whose tracing is the shortest
POLAR_DEG = {5: (10, 25, 40, 55, 70), 8: (5, 15, 25, 35, 45, 55, 65, 75)}
# Texels a side, polar angles, and the paper's sizes of eigenmaps and MDF in bytes (Wang et al. 2005, table 1).
LAYOUTS = {
    "64 x 64, 12 x 5": (64, 5, 1.3e6, 0.9e6),
    "128 x 128, 12 x 8": (128, 8, 7.5e6, 6.3e6),
    "64 x 64, 12 x 8": (64, 8, 5.3e6, 3.9e6),
}
# Rank and kind of maps that rows compare: twelve grey terms have as many bytes and look-ups as four coloured ones.
TERMS = ((4, "colour"), (12, "colour"), (4, "grey"), (5, "grey"), (8, "grey"), (12, "grey"))
KEY = light(np.radians(-35.0), np.radians(40.0))


def run(*, quick: bool) -> Result:
    """Everything; quick of two samples, on smaller tiles, fewer directions and smaller pictures."""
    errors, over_least = _errors(QUICK_SAMPLES, 12, 3) if quick else _errors(SAMPLES, 64, 5)
    times, streamed = _streamed(48 if quick else 64, 5, turns=2 if quick else 7)
    sizes = list(_sizes())
    first = next(row for row in sizes if row["method"] == "4 grey eigenmaps, bytes")
    figures = {
        "svd_rank4_relative_mse": max(float(row["error"]) for row in errors if row["method"] == "4 colour"),
        "svd_error_over_eckart_young": over_least,
        **times,
        "eigenmap_bytes": float(first["bytes"]),
        "mdf_bytes": float(next(row["bytes"] for row in sizes if row["method"] == "MDF, bytes")),
    }
    return Result(figures, [*errors, *streamed, *sizes, *_frames(quick)])


def directions(polar: int) -> Array:
    """Twelve azimuths at each of so many polar angles."""
    return rings([(angle, 12) for angle in POLAR_DEG.get(polar, POLAR_DEG[5][:polar])])


def _errors(samples: tuple[str, ...], texels: int, polar: int) -> tuple[list[Row], float]:
    """Squared errors of samples over their squares, and the worst root of it over the least that rank 4 allows."""
    rows: list[Row] = []
    over_least = 0.0
    ways = directions(polar)
    for sample in samples:
        btf = Btf(btf_below(sample, SEED, (ways, ways), texels, 1, PLANES_M[sample]), ways, ways)
        most = {colour: factor_btf(btf, 12, colour).btf for colour in ("colour", "grey")}
        for rank, colour in TERMS:
            terms = most[colour]
            factored = replace(terms, eigenmaps=terms.eigenmaps[:rank], weights=terms.weights[:rank])
            kinds = {"": factored}
            if rank in (RANK, 12):
                kinds |= {", bytes": factored.coded(np.uint8), ", halves": factored.coded(np.float16)}
            for coding, product in kinds.items():
                mse = factored_error(btf, product) ** 2
                rows.append({"method": f"{rank} {colour}{coding}", "on": sample, "error": mse,
                             "unit": "of the sum of squares", "bytes": product.nbytes})  # fmt: skip
        plain = next(row for row in rows if row["on"] == sample and row["method"] == f"{RANK} colour")
        over_least = max(over_least, float(plain["error"]) ** 0.5 / float(eckart_young(btf, RANK)))
    return rows, over_least


def _streamed(texels: int, polar: int, turns: int) -> tuple[dict[str, float], list[Row]]:
    """Times in memory and from disk, in turns, and the memory that each takes."""
    ways = directions(polar)
    tile = btf_below("brick", SEED, (ways, ways), 8, 1, PLANES_M["brick"])
    noise = np.random.default_rng(SEED).normal(1, 0.02, (texels, texels, 1))  # else the copies would compress away
    repeated = np.tile(tile, (1, 1, texels // 8, texels // 8, 1)) * noise.astype(np.float32)
    with TemporaryDirectory() as folder:
        Btf(repeated, ways, ways).save(Path(folder))
        stored, held = StoredBtf.open(Path(folder)), Btf.load(Path(folder))
        whole = held.reflectance.nbytes
        ways_of: dict[str, Callable[[], Any]] = {
            "in memory": lambda: factor_btf(held, RANK),
            "streamed": lambda: factor_btf(stored, RANK),
            "loading alone": lambda: Btf.load(Path(folder)),
        }
        turn = _turns(ways_of, turns)
        peak = {name: _peak(work) / whole for name, work in ways_of.items()}
    spent = {name: np.median(each, axis=0) for name, each in turn.items()}
    held_s, streamed_s, loading_s = (turn[name][:, 0] for name in ways_of)
    rates = {
        "in memory": float(np.median(held_s / streamed_s)),
        "loading first": float(np.median((loading_s + held_s) / streamed_s)),
    }
    rows: list[Row] = [
        {"method": f"factors, {name}", "on": f"{texels} x {texels}, 12 x {polar}", "seconds": float(spent[name][0]),
         "own_s": float(spent[name][1]), "memory": peak[name], "samples_per_s": whole / 4 / float(spent[name][0])}
        for name in spent
    ]  # fmt: skip
    rows += [{"method": f"streamed rate over {name}", "rate": rate} for name, rate in rates.items()]
    return {
        "svd_s": float(spent["in memory"][0]),
        "svd_out_of_core_rate": rates["in memory"],
        "svd_peak_memory_ratio": peak["streamed"],
    }, rows


def _turns(works: dict[str, Callable[[], Any]], turns: int) -> dict[str, Array]:
    """Seconds on the clock and of the processor (turn, 2), of works that take turns after one that is not counted."""
    spent: dict[str, list[tuple[float, float]]] = {name: [] for name in works}
    for _ in range(turns + 1):
        for name, work in works.items():
            begun_s = time.perf_counter(), time.process_time()
            work()
            spent[name].append((time.perf_counter() - begun_s[0], time.process_time() - begun_s[1]))
    return {name: np.array(each[1:]) for name, each in spent.items()}


def _peak(work: Callable[[], Any]) -> float:
    tracemalloc.start()
    work()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return float(peak)


def _sizes() -> Iterator[Row]:
    """Bytes of the paper's layouts, beside the sizes that it gives."""
    for on, (texels, polar, paper, paper_mdf) in LAYOUTS.items():
        for rank, colour in TERMS:
            ours = _coded_bytes(texels, 12 * polar, rank, colour)
            yield {"method": f"{rank} {colour} eigenmaps, bytes", "on": on, "bytes": ours, "paper": paper,
                   "over_paper": ours / paper, "raw_over_ours": (12 * polar * texels) ** 2 * 3 / ours}  # fmt: skip
        mdf = 12 * polar * texels**2
        yield {"method": "MDF, bytes", "on": on, "bytes": mdf, "paper": paper_mdf, "over_paper": mdf / paper_mdf}


def _coded_bytes(texels: int, ways: int, rank: int, colour: str) -> int:
    """Of maps of bytes, their ranges, and weights."""
    made = _made(2, ways // 12, rank, colour).coded(np.uint8)
    return made.nbytes + made.eigenmaps.nbytes * (texels**2 // 4 - 1)


def _made(texels: int, polar: int, rank: int, colour: str) -> FactoredBtf:
    """Any factors of that layout."""
    ways, rng = directions(polar), np.random.default_rng(SEED)
    mesh = DirectionMesh.from_directions(ways)
    grey = colour == "grey"
    maps = rng.random((rank, len(ways), texels, texels, 1 if grey else 3), np.float32)
    weights = rng.random((rank, len(ways), 3) if grey else (rank, len(ways)), np.float32)
    return FactoredBtf(maps, weights, mesh, mesh)


def _frames(quick: bool) -> Iterator[Row]:
    """Time of a frame of a torus by terms and coding, over that of four coloured terms of float32."""
    try:
        renderer = GlRenderer()
    except GlUnavailableError as error:
        yield {"method": "frames", "missing": str(error)}
        return
    size = (200, 150) if quick else (800, 600)
    mesh = torus()
    camera = framed(mesh, size, azimuth_rad=np.radians(-35.0), elevation_rad=np.radians(35.0))
    four, grey, eight = (_made(64, 5, *terms) for terms in ((4, "colour"), (4, "grey"), (8, "grey")))
    materials = {
        "4 colour": four, "4 colour, bytes": four.coded(np.uint8), "4 colour, halves": four.coded(np.float16),
        "4 grey": grey, "4 grey, bytes": grey.coded(np.uint8), "8 grey, bytes": eight.coded(np.uint8),
    }  # fmt: skip
    scenes = {name: Scene.of(mesh, material, camera, (KEY,)) for name, material in materials.items()}
    works: dict[str, Callable[[], Any]] = {
        name: (lambda scene=scene: renderer.draw_unread(scene)) for name, scene in scenes.items()
    }
    try:
        spent = {name: np.median(each, axis=0) for name, each in _turns(works, 5 if quick else 20).items()}
    finally:
        renderer.release()
    # A software rasteriser's time is the processor's: what else runs delays the clock.
    clock = 1 if "llvmpipe" in renderer.name else 0
    for name, each in spent.items():
        yield {"method": f"frame of {name}", "seconds": float(each[0]), "own_s": float(each[1]),
               "over_float": float(each[clock] / spent["4 colour"][clock]), "renderer": renderer.name}  # fmt: skip
