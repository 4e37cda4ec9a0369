"""SBRDF+ in one texture: its size, what its bytes cost, and k-means of the hidden points beside OpenCV's and scipy's.

`bytes_total`: on a graphics card, of 81 x 81 directions, 64 x 64 texels and three lobes of 24 floats, without coarser
levels. `centres`: what the texture has room for there. Points are those that the truth knows to be hidden, clustered by
their noisy values; errors are against the true ones. Rows have other sizes with their coarser levels, and other ways to
put centres into bytes.
"""

import time
from collections.abc import Callable, Iterator
from functools import partial

import cv2
import numpy as np
from scipy.cluster.vq import kmeans2

from processing.products.arrays import Float32
from processing.products.sbrdf_packing import SbrdfMaps, TextureLayout, pack, unpack
from processing.sbrdf.clusters import Clusters, centre_count, cluster_hidden
from processing.sbrdf.k_means import ROUNDS, TOLERANCE, k_means
from processing.sbrdf.samples import Samples
from service.bench import Result
from tests.benchmarks.yardsticks.btf_samples import BtfWithTruth, ray_traced, ring_of
from tests.benchmarks.yardsticks.material_samples import bonn_directions
from tests.reference.sbrdf_plus import product

SEED = 1
HIDING = ("weave", "pipe")
POINTS_PER_CENTRE = (80, 40, 20, 10)
CODINGS = {
    "linear": (lambda share: share, lambda code: code),
    "square root": (np.sqrt, np.square),
    "cube root": (np.cbrt, lambda code: code**3),
    "logarithm": (lambda share: np.log1p(63 * share) / np.log(64), lambda code: np.expm1(code * np.log(64)) / 63),
}

Row = dict[str, object]
Method = Callable[[Float32, int], tuple[Float32, Float32]]


def run(*, quick: bool) -> Result:
    """One sample of few texels and views, or two of 64 x 64 texels and all 81."""
    full_size = product(lights=81, views=81, height=64, width=64, centres=1984)
    figures = {"bytes_total": float(full_size.size_bytes), "centres": float(centre_count(81, 81, 64, 64))}
    rows = list(_sizes())
    for name in HIDING[:1] if quick else HIDING:
        scene = _scene(name, quick=quick)
        rows += [*_clusters(scene), *_codes(scene)]
    return Result(figures, rows)


def _scene(name: str, *, quick: bool) -> BtfWithTruth:
    directions = bonn_directions()
    if not quick:
        return ray_traced(name, 64, SEED, directions, directions)
    grazing = directions[ring_of(directions) >= 60][::6]
    return ray_traced(name, 24, SEED, directions, np.concatenate([directions[:1], grazing]))


def _sizes() -> Iterator[Row]:
    """Bytes of whole products: the texture, the lobes, and all coarser levels down to one texel."""
    for side in (32, 64, 128, 256):
        for floats in (16, 24):
            sizes = [_bytes(side >> level, floats) for level in range(side.bit_length())]
            yield {"method": f"SBRDF+, {floats} floats", "size": f"{side} x {side} x 81 x 81", "bytes": sizes[0],
                   "bytes_coarser": sum(sizes[1:]), "bytes_btf": side * side * 81 * 81 * 3,
                   "centres": centre_count(81, 81, side, side)}  # fmt: skip


def _bytes(side: int, floats: int) -> int:
    rows, columns = TextureLayout(81, 81, side, side).shape
    return rows * columns * 4 + side * side * floats * 4


def _clusters(scene: BtfWithTruth) -> Iterator[Row]:
    """Error and time against the number of centres, views sharing them as the analysis does."""
    points, true = _hidden(scene, measured=True), _hidden(scene, measured=False)
    count = sum(map(len, points))
    strength = np.sqrt(np.mean(np.square(np.concatenate(true), dtype=np.float64)))
    k_means(points[0][:2], 1)  # the compiler's time is not the method's
    for each in POINTS_PER_CENTRE:
        shares = [max(round(len(view) / each), 1) for view in points]
        for method, cluster in _methods().items():
            begun = time.perf_counter()
            found = [cluster(view, share) for view, share in zip(points, shares, strict=True)]
            seconds = time.perf_counter() - begun
            error, inertia = _squared(true, found) / count, _squared(points, found)
            yield {"method": method, "peer": method != "k-means", "size": f"{scene.name}, {count} points",
                   "seconds": seconds, "error": float(np.sqrt(error) / strength), "inertia": inertia,
                   "unit": "rms of the values", "parameter": f"hidden points of {scene.name}, by centres",
                   "value": sum(shares)}  # fmt: skip


def _methods() -> dict[str, Method]:
    return {"k-means": _ours, "OpenCV's k-means": _opencv, "scipy's k-means": _scipy}


def _ours(view: Float32, count: int) -> tuple[Float32, Float32]:
    found = k_means(view, count)
    return found.centres, found.index


def _opencv(view: Float32, count: int) -> tuple[Float32, Float32]:
    cv2.setRNGSeed(SEED)
    stop = (cv2.TERM_CRITERIA_MAX_ITER + cv2.TERM_CRITERIA_EPS, ROUNDS, TOLERANCE)
    _, index, centres = cv2.kmeans(view, count, None, stop, 1, cv2.KMEANS_PP_CENTERS)
    return centres, index[:, 0]


def _scipy(view: Float32, count: int) -> tuple[Float32, Float32]:
    return kmeans2(view, count, minit="++", rng=SEED)


def _squared(views: list[Float32], found: list[tuple[Float32, Float32]]) -> float:
    """Sum over points of the mean squared difference of their values from their centre's."""
    apart = [view - centres[index] for view, (centres, index) in zip(views, found, strict=True)]
    return float(sum(np.square(one, dtype=np.float64).mean(axis=1).sum() for one in apart))


def _hidden(scene: BtfWithTruth, *, measured: bool) -> list[Float32]:
    """Values of the hidden points (n, light * 3) of each view that has some."""
    samples = Samples.of(scene.btf) if measured else Samples(scene.true, Samples.of(scene.btf).scale)
    hidden = scene.truth.hidden
    views = (np.moveaxis(samples.seen_from(v)[:, hidden[v]], 1, 0) for v in np.flatnonzero(hidden.any(axis=(1, 2))))
    return [np.ascontiguousarray(view).reshape(len(view), -1) for view in views]


def _codes(scene: BtfWithTruth) -> Iterator[Row]:
    """What eight bits for a centre's value add to the squared error of hidden points, over that of the centres."""
    samples, hidden = Samples.of(scene.btf), scene.truth.hidden
    clusters = cluster_hidden(samples, hidden, min(int(hidden.sum()) // 20, centre_count(*samples.shape[:4])))
    true = Samples(scene.true, samples.scale)
    plain = _error(true, hidden, clusters, clusters.centres)
    codes = {"packed": partial(_packed, hidden)} | {name: partial(_coded, name) for name in CODINGS}
    for name, code in codes.items():
        added = _error(true, hidden, clusters, code(clusters.centres)) / plain - 1
        yield {"method": f"centres, {name}", "parameter": "error added by eight bits", "value": scene.name,
               "unit": "of the squared error", "error": added}  # fmt: skip


def _error(true: Samples, hidden: Float32, clusters: Clusters, centres: Float32) -> float:
    """Mean squared difference of hidden points' true values from their centres'."""
    sums = [
        np.square(np.moveaxis(true.seen_from(v)[:, hidden[v]], 1, 0) - centres[clusters.index[v][hidden[v]]]).sum()
        for v in range(len(hidden))
    ]
    return float(sum(sums) / hidden.sum())


def _coded(name: str, centres: Float32) -> Float32:
    forth, back = CODINGS[name]
    scale = centres.max()
    return back(np.rint(255 * forth(np.clip(centres / scale, 0, 1))) / 255) * scale


def _packed(hidden: Float32, centres: Float32) -> Float32:
    """Through the texture of a product of as many views."""
    lit = np.ones((centres.shape[1], *hidden.shape[1:]), np.float32)
    still, none = np.zeros((*hidden.shape, 2), np.float32), np.zeros(hidden.shape, np.uint16)
    return unpack(pack(SbrdfMaps(lit, still, none.astype(bool), none, centres))).centres
