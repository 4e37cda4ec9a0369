"""The analysis of whole BTFs: what each step leaves of the error, shadows against the truth, time and its growth.

`mse_sbrdf`, `mse_stvs`, `mse_final`: mean squared error over the noise-free BTF, linear with the cosine inside, of
lobes fitted to all samples, of lobes and one shadow for each light, and of SBRDF+ as its bytes give it back; means
over the samples. `final_over_sbrdf` is the worst sample's, `shadow_precision` and `shadow_recall` too. `analysis_s`: 64
x 64 texels and 81 x 81 directions, the slowest sample, in the full run alone. `cost_exponent`: logarithm of the time's
growth over that of the number of texels, from 32 x 32 to 128 x 128 (quick: 64 x 64), for 19 x 19 (quick: 9 x 9)
directions. Rows have errors of each ring of views, their median, 90 % and worst over texels, the paper's rules for
shadows beside ours, directions that were not measured, and seconds of each step.
"""

import time
from collections.abc import Iterator

import numpy as np

from processing.products import Btf, SbrdfPlus
from processing.products.arrays import Float64
from processing.sbrdf.analysis import SbrdfAnalysis, analyse
from processing.sbrdf.drawn import DrawnLobes, DrawnPlus, View
from processing.sbrdf.samples import Samples
from service.bench import Result
from tests.benchmarks.yardsticks.btf_samples import PLANES_M, BtfWithTruth, quick_directions, ray_traced, ring_of
from tests.benchmarks.yardsticks.material_samples import bonn_directions, rings

SEED = 1
SAMPLES = ("brick", "weave", "pipe", "grass", "peanut")
METHODS = ("SBRDF", "paper's STVS", "STVS", "SBRDF+")

Row = dict[str, object]


def run(*, quick: bool) -> Result:
    """Five samples of 12 x 12 texels and 19 x 19 directions, or of 64 x 64 and 81 x 81."""
    texels, directions = (12, quick_directions()) if quick else (64, bonn_directions())
    analyse(ray_traced("brick", 4, SEED + 1, *[quick_directions()] * 2).btf)  # the compiler's time is not the method's
    rows, errors, shadows, seconds = [], [], [], []
    for name in SAMPLES:
        scene = ray_traced(name, texels, SEED, directions, directions)
        begun = time.perf_counter()
        found = analyse(scene.btf)
        seconds.append(time.perf_counter() - begun)
        squared = {method: _squared_errors(scene.true, view) for method, view in _drawn(found, scene.true).items()}
        errors.append([squared[method].mean() for method in METHODS])
        shadows.append(_shadow_rates(found.shadowed(), scene.truth.shadowed))
        rows += [*_errors(scene, squared), _shadow_row(scene, "ours", shadows[-1]), _paper_shadows(scene, found)]
        rows += [_unmeasured(scene, found)] if name in SAMPLES[:2] else []
        rows += [_seconds(scene, found, seconds[-1])]
    means, worst = np.array(errors), np.min(shadows, axis=0)
    figures = {
        "mse_sbrdf": float(means[:, 0].mean()),
        "mse_stvs": float(means[:, 2].mean()),
        "mse_final": float(means[:, 3].mean()),
        "final_over_sbrdf": float((means[:, 3] / means[:, 0]).max()),
        "shadow_precision": float(worst[0]),
        "shadow_recall": float(worst[1]),
        "cost_exponent": _cost_exponent(quick=quick),
    }
    return Result(figures if quick else figures | {"analysis_s": max(seconds)}, rows)


def _drawn(found: SbrdfAnalysis, true: Btf) -> dict[str, View]:
    ways = true.light_directions, true.view_directions
    drawn = (
        DrawnLobes(found.sbrdf, *ways),
        DrawnLobes(found.sbrdf, *ways, found.top_shadow),
        DrawnLobes(found.stvs.lobes, *ways, found.stvs.shadow),
        DrawnPlus(found.product.quantised()),
    )
    return {method: one.seen_from for method, one in zip(METHODS, drawn, strict=True)}


def _squared_errors(true: Btf, drawn: View) -> Float64:
    """Mean over lights and channels, (view, y, x)."""
    plain = Samples(true, 1.0)
    views = (np.square(drawn(view) - plain.seen_from(view)) for view in range(true.shape[1]))
    return np.stack([view.mean(axis=(0, 3), dtype=np.float64) for view in views])


def _errors(scene: BtfWithTruth, squared: dict[str, Float64]) -> Iterator[Row]:
    """Of all views and of each ring; the paper's STVS has the lobes of SBRDF and the shadows that the top sees."""
    polar = ring_of(scene.true.view_directions)
    for ring in (None, *np.unique(polar).tolist()):
        chosen = slice(None) if ring is None else polar == ring
        for method, error in squared.items():
            of_texels = error[chosen].mean(axis=0)
            yield {"method": method, "size": _size(scene), "sample": scene.name,
                   "polar_deg": "all" if ring is None else ring, "mse": float(of_texels.mean()),
                   "mse_over_sbrdf": float(of_texels.mean() / squared["SBRDF"][chosen].mean()),
                   "mse_median": float(np.median(of_texels)), "mse_p90": float(np.quantile(of_texels, 0.9)),
                   "mse_worst": float(of_texels.max()), "plane_mm": 1e3 * PLANES_M[scene.name]}  # fmt: skip


def _shadow_rates(found: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """Precision and recall."""
    both = np.count_nonzero(found & true)
    return both / max(np.count_nonzero(found), 1), both / max(np.count_nonzero(true), 1)


def _shadow_row(scene: BtfWithTruth, rule: str, rates: tuple[float, float]) -> Row:
    return {"method": f"shadows, {rule}", "size": _size(scene), "sample": scene.name, "precision": rates[0],
            "recall": rates[1]}  # fmt: skip


def _paper_shadows(scene: BtfWithTruth, found: SbrdfAnalysis) -> Row:
    """Error > 0.3 and BTF < 0.3 of the normalised values, against the lobes of all samples."""
    samples = Samples.of(scene.btf)
    lobes = DrawnLobes(found.sbrdf, samples.light_directions, samples.view_directions)
    shadowed = np.empty(scene.truth.shadowed.shape, bool)
    for view in range(samples.shape[1]):
        value, drawn = samples.seen_from(view).mean(axis=-1), lobes.seen_from(view).mean(axis=-1) / samples.scale
        shadowed[:, view] = (drawn - value > 0.3 * value) & (value < 0.3)
    return _shadow_row(scene, "the paper's", _shadow_rates(shadowed, scene.truth.shadowed))


def _unmeasured(scene: BtfWithTruth, found: SbrdfAnalysis) -> Row:
    """Squared error over the squares, between the measured directions: 8 lights and 8 views within 65 deg."""
    rng = np.random.default_rng(SEED)
    cosine, azimuth = rng.uniform(np.cos(np.radians(65)), 1, 16), rng.uniform(0, 2 * np.pi, 16)
    sine = np.sqrt(1 - cosine**2)
    ways = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine], axis=1)
    true = ray_traced(scene.name, scene.true.shape[2], SEED, ways[:8], ways[8:]).true
    shifted = found.product
    still = SbrdfPlus(found.stvs.lobes, found.stvs.shadow, np.zeros_like(shifted.shift), np.zeros_like(shifted.hidden),
                      shifted.cluster, shifted.centres, shifted.lights, shifted.views)  # fmt: skip
    return {"method": "between the directions", "size": _size(scene), "sample": scene.name,
            "STVS": _relative(still, true), "SBRDF+": _relative(shifted.quantised(), true)}  # fmt: skip


def _relative(product: SbrdfPlus, true: Btf) -> float:
    height, width = product.lobes.shape
    rows, columns = np.mgrid[:height, :width]
    uv = np.stack([(columns + 0.5) / width, (rows + 0.5) / height], axis=-1).reshape(-1, 2)
    error = squares = 0.0
    for light, view in np.ndindex(*true.shape[:2]):
        ways = (
            np.broadcast_to(way, (len(uv), 3)) for way in (true.light_directions[light], true.view_directions[view])
        )
        wanted = true.reflectance[light, view].reshape(-1, 3) * true.light_directions[light, 2]
        error += float(np.square(product.evaluate(uv, *ways) - wanted).sum())
        squares += float(np.square(wanted, dtype=np.float64).sum())
    return error / squares


def _seconds(scene: BtfWithTruth, found: SbrdfAnalysis, seconds: float) -> Row:
    return {"method": "seconds of the steps", "size": _size(scene), "sample": scene.name, "all": seconds,
            **found.seconds}  # fmt: skip


def _cost_exponent(*, quick: bool) -> float:
    ways = rings(((0, 1), (45, 8))) if quick else quick_directions()
    sides = (32, 64) if quick else (32, 128)
    seconds = []
    for side in sides:
        scene = ray_traced("brick", side, SEED, ways, ways)
        begun = time.perf_counter()
        analyse(scene.btf)
        seconds.append(time.perf_counter() - begun)
    return float(np.log(seconds[1] / seconds[0]) / np.log((sides[1] / sides[0]) ** 2))


def _size(scene: BtfWithTruth) -> str:
    lights, views, height, width, _ = scene.true.shape
    return f"{scene.name}, {height} x {width} x {lights} x {views}"
