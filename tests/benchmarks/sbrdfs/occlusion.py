"""Shifts and hidden points of ray-traced BTFs against their truth: voted by flows, refined, and by other flows.

`hidden_precision` and `hidden_recall` are the least of the samples with overhangs, after the refinement;
`hidden_after_over_before` is refined over voted hidden points of all samples together; `shift_error_texels` the median
over all samples' points that are hidden neither in truth nor by us. The refinement is told what the top view sees for
every view, as if nothing shone: figures do not depend on how well lobes are fitted. Rows have each sample and ring, the
share of brightness that is met wrongly, and the vote by each flow of OpenCV under fewer lights in two views.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from processing.products.arrays import Float32
from processing.sbrdf.flow_votes import (
    HIDDEN_ABOVE,
    Occlusion,
    count_votes,
    dense_inverse_search,
    flows_between,
    pictures_of,
    vote_flow,
)
from processing.sbrdf.heights import points
from processing.sbrdf.refinement import distances, refine
from processing.sbrdf.samples import Samples
from service.bench import Result
from tests.benchmarks.yardsticks.btf_samples import SAMPLES, BtfWithTruth, quick_directions, ray_traced, ring_of
from tests.benchmarks.yardsticks.material_samples import bonn_directions

SEED = 1
OVERHANGS = ("weave", "peanut", "grass", "pipe")
FLOW_LIGHTS = 9
FLOWS: dict[str, Callable[[], cv2.DenseOpticalFlow]] = {
    "DIS, to full resolution": dense_inverse_search,
    "DIS, medium": lambda: cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM),
    "Farneback": lambda: cv2.FarnebackOpticalFlow.create(numLevels=3, winSize=7, polyN=5, polySigma=1.1),
    "DeepFlow": lambda: cv2.optflow.createOptFlow_DeepFlow(),
    "TV-L1": lambda: cv2.optflow.createOptFlow_DualTVL1(),
}

Row = dict[str, object]


@dataclass
class FromTop:
    """What the top view sees (light, y, x, 3), for every view."""

    values: Float32

    def seen_from(self, view: int) -> Float32:
        return self.values


def run(*, quick: bool) -> Result:
    """Small tiles under few directions, or 64 x 64 texels and 81 x 81 directions, with every flow."""
    directions, texels = (quick_directions(), 24) if quick else (bonn_directions(), 64)
    samples = ("weave", "pipe") if quick else SAMPLES
    _warm_up()
    rows: list[Row] = []
    scored: list[tuple[str, Occlusion, Occlusion, BtfWithTruth]] = []
    for name in samples:
        scene = ray_traced(name, texels, SEED, directions, directions)
        voted, refined, found = _found(scene)
        rows += found
        scored.append((name, voted, refined, scene))
        if name == "pipe" and not quick:
            rows += _by_other_flows(scene)
    return Result(_figures(scored), rows)


def _warm_up() -> None:
    directions = quick_directions()[::4]
    _found(ray_traced("brick", 8, SEED, directions, directions))


def _figures(scored: list[tuple[str, Occlusion, Occlusion, BtfWithTruth]]) -> dict[str, float]:
    hidden = [_hidden(refined, scene) for name, _, refined, scene in scored if name in OVERHANGS]
    errors = np.concatenate([_errors(refined, scene)[0] for _, _, refined, scene in scored])
    before, after = (sum(int(some[which].hidden.sum()) for some in scored) for which in (1, 2))
    return {
        "hidden_precision": min(precision for precision, _ in hidden),
        "hidden_recall": min(recall for _, recall in hidden),
        "hidden_after_over_before": after / max(before, 1),
        "shift_error_texels": float(np.median(errors)),
    }


def _found(scene: BtfWithTruth) -> tuple[Occlusion, Occlusion, list[Row]]:
    samples = Samples.of(scene.btf)
    start_s = time.perf_counter()
    voted = vote_flow(samples)
    middle_s = time.perf_counter()
    refined = refine(samples, FromTop(samples.seen_from(samples.top)), voted)
    end_s = time.perf_counter()
    rows: list[Row] = []
    for method, found, seconds in (
        ("no shift", _unmoved(samples), 0.0),
        ("voted", voted, middle_s - start_s),
        ("refined", refined, end_s - middle_s),
    ):
        whole = {"seconds": seconds, "mismatch": _mismatch(samples, found)}
        rows.append({"method": method, "sample": scene.name, **_row(found, scene, slice(None)), **whole})
        rings = ring_of(scene.btf.view_directions)
        rows += [
            {"method": method, "sample": scene.name, "ring_deg": int(ring), **_row(found, scene, rings == ring)}
            for ring in np.unique(rings)
            if ring > 0
        ]
    return voted, refined, rows


def _row(found: Occlusion, scene: BtfWithTruth, views: object) -> Row:
    errors, lengths = _errors(found, scene, views)
    precision, recall = _hidden(found, scene, views)
    spread = np.quantile(errors, (0.5, 0.75, 0.9)) if len(errors) else np.full(3, np.nan)
    return {
        "error": float(spread[0]), "unit": "texels, median", "p75": float(spread[1]), "p90": float(spread[2]),
        "true_shift": float(np.median(lengths)) if len(lengths) else float("nan"),
        "hidden": float(found.hidden[views].mean()), "truly_hidden": float(scene.truth.hidden[views].mean()),
        "precision": precision, "recall": recall,
    }  # fmt: skip


def _errors(found: Occlusion, scene: BtfWithTruth, views: object = slice(None)) -> tuple[Float32, Float32]:
    """Distance to the true shift, the short way, of points hidden neither by us nor in truth; and its length."""
    side = found.shift.shape[2]
    true = scene.truth.shift[views]
    apart = found.shift[views] - true
    apart -= side * np.rint(apart / side)
    seen = ~found.hidden[views] & ~scene.truth.hidden[views] & np.isfinite(true).all(axis=-1)
    return np.linalg.norm(apart[seen], axis=-1), np.linalg.norm(true[seen], axis=-1)


def _hidden(found: Occlusion, scene: BtfWithTruth, views: object = slice(None)) -> tuple[float, float]:
    """Precision and recall of the hidden points, 1 where there are none to be wrong about."""
    ours, true = found.hidden[views], scene.truth.hidden[views]
    both = int((ours & true).sum())
    return both / int(ours.sum()) if ours.any() else 1.0, both / int(true.sum()) if true.any() else 1.0


def _mismatch(samples: Samples, found: Occlusion) -> float:
    """Mean absolute difference to what the top view sees at x + shift, over points that are not hidden; white is 1."""
    drawn = points(samples.seen_from(samples.top))
    apart = [
        distances(points(samples.seen_from(view)), drawn, found.shift[view])[~found.hidden[view]]
        for view in range(samples.shape[1])
    ]
    return float(np.nanmean(np.concatenate(apart)))


def _by_other_flows(scene: BtfWithTruth) -> Iterator[Row]:
    """Votes of each flow of OpenCV over the same few lights, in one view of each of the two lowest rings."""
    samples = Samples.of(scene.btf)
    rings = ring_of(samples.view_directions)
    views = np.array([np.flatnonzero(rings == ring)[0] for ring in np.unique(rings)[-2:]])
    few = slice(0, None, max(samples.shape[0] // FLOW_LIGHTS, 1))
    top = pictures_of(samples.seen_from(samples.top)[few])
    pictures = {view: pictures_of(samples.seen_from(view)[few]) for view in views}
    for method, flow in FLOWS.items():
        found = _unmoved(samples)
        start_s = time.perf_counter()
        for view in views:
            flows, meets = flows_between(pictures[view], top, flow())
            count_votes(flows, meets, found.shift[view], found.hidden_ratio[view])
        found.hidden[:] = found.hidden_ratio > HIDDEN_ABOVE
        seconds = time.perf_counter() - start_s
        yield {"method": f"flow: {method}", "sample": scene.name, **_row(found, scene, views), "seconds": seconds}


def _unmoved(samples: Samples) -> Occlusion:
    shape = samples.shape[1:4]
    return Occlusion(np.zeros((*shape, 2), np.float32), np.zeros(shape, bool), np.zeros(shape, np.float32))
