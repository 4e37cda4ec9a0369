"""Range error over what a sweep meets, one thing varied at a time, beside other estimators on the same frames.

Cards: `tests/reference/stripe_cards.py`; the estimators: `yardsticks/stripe_peers.py`; the whole sweep of a relief:
`yardsticks/relief_sweep.py`. Errors are in micrometres of height or displacement, root mean square with median, 95th
percentile and largest of their size beside; `measured` is the share of pixels, or of rows of frames, with a value.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from processing.laser.mdf import measure_sweep
from processing.laser.range_image import range_image
from processing.laser.space_time import Estimator, PulseSettings, peak_times
from processing.radiometry.sensor import Sensor
from service.bench import Result
from tests.benchmarks.yardsticks.relief_sweep import HOLDER, photograph
from tests.benchmarks.yardsticks.stripe_peers import PEERS, Peer
from tests.reference.stripe_cards import Camera, Card, range_bound_m

SENSOR = Sensor(*(getattr(Camera(), name) for name in ("black_dn", "white_dn", "gain_e_per_dn", "read_noise_e")))
SWEEP_M = 0.104
SLOW_ROWS = 4  # of each card, for methods that take a millisecond per pixel
SAMPLES = ("white", "pipe", "brick", "weave", "peanut", "grass")  # ever rougher
RELIEF_STRIPE = {"small": (0.9, 1.0), "full": (0.9, 3.3)}  # sigma in frames, and in red pixels
BEAM_M = (0.0008, 0.0010)  # Curless and Levoy's laser: from the middle to where e^-2 of its light is left


@dataclass(frozen=True)
class Variation:
    """One property of a card: its values, and those that the short form takes."""

    name: str
    card: Callable[[float], Card]
    values: Sequence[float]
    quick: Sequence[float]


def edge(ratio: float, **changes: float) -> Card:
    """A card with a step of reflectance, seen as far as the stripe's e^-2 half width on either side of it."""
    card = Card(ratio=ratio, **changes)
    return replace(card, half_m=2 * card.trace_m)


VARIATIONS = (
    Variation("slope towards the laser in deg", lambda v: Card(slope_rad=np.radians(v)),
              (-35, -25, -15, 0, 15, 30, 45, 60, 70), (-30, 0, 30, 60)),
    Variation("reflectance ratio at an edge", edge, (1, 1.5, 2, 3, 5, 7, 10), (1, 3, 10)),
    Variation("texture: deviation of log albedo", lambda v: Card(texture=v),
              (0, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5), (0, 0.1, 0.3)),
    Variation("stripe sigma in mm", lambda v: Card(sigma_m=v / 1e3),
              (0.2, 0.3, 0.4, 0.6, 0.8, 1.2, 1.6, 2.4), (0.3, 0.8, 1.6)),
    Variation("frames per 104 mm sweep", lambda v: Card(advance_m=SWEEP_M / v),
              (30, 46, 65, 92, 130, 184, 368), (46, 92, 184)),
    Variation("speckle contrast", lambda v: Card(speckle=v), (0, 0.02, 0.05, 0.1, 0.2, 0.3), (0, 0.05, 0.2)),
    Variation("electrons of a white pixel", lambda v: Card(peak_e=v),
              (60, 120, 250, 500, 1000, 4000, 15000, 30000, 60000), (250, 4000, 30000)),
    Variation("ambient light in electrons", lambda v: Card(ambient_e=v), (3, 30, 100, 300, 1000, 3000), (30, 1000)),
    Variation("height of a second peak 6 mm later", lambda v: Card(echo=v, half_m=0.002),
              (0, 0.1, 0.2, 0.3, 0.35, 0.5, 0.8), (0, 0.2, 0.5)),
    Variation("mm to a second peak of 0.3", lambda v: Card(echo=0.3, echo_m=v / 1e3, half_m=0.002),
              (1, 1.5, 2, 3, 4, 6, 10), (1.5, 3, 6)),
    Variation("lens blur in px at a 10:1 edge", lambda v: edge(10, blur_px=v), (0, 0.2, 0.3, 0.5, 0.7), (0, 0.5)),
    Variation("stripe sigma in mm at a 10:1 edge", lambda v: edge(10, sigma_m=v / 1e3),
              (0.2, 0.3, 0.4, 0.6, 0.8, 1.2, 1.6), (0.3, 0.8)),
)  # fmt: skip


def run(*, quick: bool) -> Result:
    """All variations and reliefs; quick with a third of the values, two reliefs, none at full resolution."""
    compare(Card(rows=1), seed=0)  # compiles what is compiled, outside of the run times
    rows = []
    for number, variation in enumerate(VARIATIONS):
        for value in variation.quick if quick else variation.values:
            card = replace(variation.card(value), rows=48 if quick else 96)
            about = {"parameter": variation.name, "value": value, "unit": "µm", "bound": range_bound_m(card) * 1e6}
            rows += [about | row for row in compare(card, seed=number)]
    reliefs = {sample: relief_rows(sample, "small") for sample in (("brick", "grass") if quick else SAMPLES)}
    for sample, found in reliefs.items():
        rows += [row | {"parameter": "whole sweep over this", "value": sample} for row in found]
    reliefs = {"small brick": reliefs["brick"]} | ({} if quick else {"full brick": relief_rows("brick", "full")})
    for size, found in reliefs.items():
        rows += [row | {"size": size} for row in found if "reference" not in row]
    error = {row["method"]: row["error"] for row in reliefs["small brick"]}
    gain = error["argmax"] / error["ours"]
    return Result({"gain_over_argmax": gain, "albedo_step_error_reduction": step_error_reduction(rows=96)}, rows)


def compare(card: Card, seed: int) -> list[dict[str, object]]:
    """A row for each method on one card's frames."""
    frames = card.shoot(seed)
    about = (card.sigma_m / np.cos(card.angle_rad) / card.advance_m, card.trace_m / card.pixel_m)
    rows = []
    for method in METHODS:
        shown = frames[:, :: max(card.rows // SLOW_ROWS, 1)] if method.slow else frames
        begun_s = time.perf_counter()
        found = method.find(shown, about)
        seconds = (time.perf_counter() - begun_s) * frames.shape[1] / shown.shape[1]
        rows.append(_row(method, seconds, _errors(card, found, method.in_space)))
    deviation = np.sqrt(peak_times(frames, SENSOR).variance) * card.advance_m / np.tan(card.angle_rad)
    return [*rows, _stated(deviation[:, card.looked_at])]


def _errors(card: Card, found: np.ndarray, in_space: bool) -> np.ndarray:
    """Heights less the surface's: where the true stripe, or the pixel, is in the part that is looked at."""
    if not in_space:
        height = card.range_m(found + card.times[0], card.x_m)
        return (height - card.surface_m(card.x_m))[:, card.looked_at]
    x_m = np.interp(found, np.arange(len(card.x_m)), card.x_m)
    crossing = np.abs(card.times * card.advance_m / card.spread) <= card.half_m
    return (card.range_m(card.times[:, None], x_m) - card.surface_m(x_m))[crossing]


def _row(method: Peer, seconds: float, errors_m: np.ndarray) -> dict[str, object]:
    size_um = np.abs(errors_m[np.isfinite(errors_m)]) * 1e6
    row = {"method": method.name, "peer": not method.name.startswith("ours"), "settings": method.settings,
           "seconds": seconds, "measured": size_um.size / errors_m.size, "error": None}  # fmt: skip
    if size_um.size:
        median, p95, largest = (float(v) for v in np.percentile(size_um, (50, 95, 100)))
        row |= {"error": float(np.sqrt(np.mean(size_um**2))), "median": median, "p95": p95, "largest": largest}
    return row


def _stated(deviation_m: np.ndarray) -> dict[str, object]:
    """A row with the standard deviations that ours gives its own values, as if they were errors."""
    said = Peer("ours says", lambda *_: deviation_m, "the root of each value's variance")
    return _row(said, 0.0, deviation_m) | {"reference": True}


def step_error_reduction(rows: int) -> float:
    """1 - ours / row centroid in RMS range error near a 10:1 step, for the beam width where it is least."""
    found = []
    for beam_m in np.linspace(*BEAM_M, 3):
        card = edge(10.0, sigma_m=beam_m / 2, rows=rows, advance_m=Card.pixel_m)
        errors = {row["method"]: row["error"] for row in compare(card, seed=20)}
        found.append(1 - errors["ours"] / errors["row centroid"])
    return float(min(found))


def relief_rows(sample: str, size: str) -> list[dict[str, object]]:
    """A row for each method on one sweep, on the pixels that ours measures.

    All use the laser planes that ours calibrated, so that the rows differ by their times alone.
    """
    relief = photograph(1, sample, size)
    sweep = relief.sweep
    ours = measure_sweep(sweep, HOLDER)
    wanted = np.isfinite(ours.image.displacement_m)
    rows = [_stated(np.sqrt(ours.image.variance_m2[wanted])) | {"unit": "µm"}]
    for method in (method for method in METHODS if not method.slow):
        begun_s = time.perf_counter()
        found = method.find(relief.red if method.in_space else sweep.frames, RELIEF_STRIPE[size])
        seconds = time.perf_counter() - begun_s
        if method.in_space:
            errors = relief.row_errors(found, ours.laser, wanted)
        else:
            times = np.where(wanted, found, np.nan).astype(np.float32)
            image = range_image(replace(ours.peaks, time_frames=times), sweep.camera, np.eye(4), HOLDER, ours.laser)
            errors = (image.displacement_m - relief.displacement_m)[wanted]
        rows.append(_row(method, seconds, errors) | {"unit": "µm"})
    return rows


def _ours(name: str, settings: PulseSettings, said: str) -> Peer:
    return Peer(name, lambda frames, _: peak_times(frames, SENSOR, settings).time_frames, said)


METHODS = (
    _ours("ours", PulseSettings(), "Gaussian, maximum likelihood; the sensor's gain and noise"),
    _ours("ours: centroid", PulseSettings(estimator=Estimator.CENTROID), "for comparison"),
    _ours("ours: parabola", PulseSettings(estimator=Estimator.PARABOLA), "for comparison"),
    *PEERS,
)
