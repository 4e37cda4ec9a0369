"""Times of single pulses over their Cramer-Rao bound, stated deviations, outliers, and the speed of a camera's sweep.

Pulses lie anywhere between frames, under photons, read noise and rounding. Each figure over widths and heights is the
worst of them; rows have all, with peers on the same frames. `sampling_error`: how far chance moves a row's error.
"""

import time

import numpy as np

from processing.laser.peak_tracker import track_peaks
from processing.laser.space_time import PeakStatus, peak_times
from processing.radiometry.sensor import Sensor
from service.bench import Result
from tests.benchmarks.yardsticks.bandwidth import fastest, read_bandwidth
from tests.benchmarks.yardsticks.stripe_peers import PEERS, parabola

SENSOR = Sensor(256.0, 4095.0, 4.0, 4.0)
FRAMES, BACKGROUND_E = 60, 40.0
WIDTHS, HEIGHTS_E = (0.7, 1.5, 3.0), (100.0, 1000.0, 10000.0)
CLIPPED = 1.2  # times full well: of the samples within three widths, a fifth
GREEN = 0.12  # of the stripe's light, in the pixels of a mosaic that tell the width where the red ones are clipped
OUTLIER = 6.0  # bounds
SHAPE, SWEEP = (768, 1024), 200


def run(*, quick: bool) -> Result:
    """Nine kinds of pulses, clipped ones, and 200 frames of a camera; quick with a quarter of the pulses."""
    pulses = 25000 if quick else 100000
    rows = [row for width in WIDTHS for height in HEIGHTS_E for row in compare(width, height, pulses)]
    clipped = [row for width in WIDTHS for row in compare(width, CLIPPED * SENSOR.saturation_e, pulses)]
    ours, saturated = ([row for row in part if row["method"] == "ours"] for part in (rows, clipped))
    calibration = max((row["over_its_sigma"] for row in ours), key=lambda ratio: abs(np.log(ratio)))
    figures = {
        "peak_time_rmse_over_crb": max(row["error"] for row in ours),
        "peak_time_rmse_over_crb_saturated": max(row["error"] for row in saturated),
        "peak_outliers": max(row["outliers"] for row in ours if row["value"] == HEIGHTS_E[0]),
        "sigma_t0_calibration": calibration,
    }
    speed, speed_rows = sweep_speed(turns=3 if quick else 8)
    return Result(figures | speed, [*rows, *clipped, *speed_rows])


def compare(width: float, height_e: float, pulses: int) -> list[dict[str, object]]:
    """A row for ours and each peer in time that is not slow, on one kind of pulses.

    Beside clipped ones ours sees those of the green pixels, as in any mosaic.
    """
    rng = np.random.default_rng((int(10 * width), int(height_e)))
    middles = FRAMES / 2 + rng.uniform(-5, 5, pulses)
    frames = mosaic = shoot(middles, width, height_e, rng)
    deviation = bound(middles, width, height_e)
    if height_e > SENSOR.saturation_e:
        mosaic = np.concatenate([frames, shoot(middles, width, GREEN * height_e, rng)], axis=1)
    begun_s = time.perf_counter()
    peaks = peak_times(mosaic, SENSOR)
    seconds = (time.perf_counter() - begun_s) * frames.size / mosaic.size
    error = np.where(peaks.status[0] == PeakStatus.OK, peaks.time_frames[0] - middles, np.nan)
    about = {"parameter": f"electrons of a pulse, sigma {width:g} frames", "value": height_e, "bound": 1.0,
             "unit": "bounds"}  # fmt: skip
    own = float(np.sqrt(np.nanmean(error**2 / peaks.variance[0])))
    rows = [about | _row("ours", seconds, error, deviation) | {"over_its_sigma": own}]
    for peer in (peer for peer in PEERS if not (peer.slow or peer.in_space)):
        begun_s = time.perf_counter()
        found = peer.find(frames, (width, 1.0))[0]
        rows.append(about | _row(peer.name, time.perf_counter() - begun_s, found - middles, deviation) | {"peer": True})
    return rows


def shoot(middles: np.ndarray, width: float, height_e: float, rng: np.random.Generator) -> np.ndarray:
    """Frames (t, 1, n) in raw_dn of Gaussian pulses about these moments."""
    u = (np.arange(FRAMES)[:, None] - middles) / width
    electrons = rng.poisson(height_e * np.exp(-0.5 * u * u) + BACKGROUND_E)
    noisy = electrons + rng.normal(0, SENSOR.read_noise_e, electrons.shape)
    raw_dn = np.clip(np.rint(noisy / SENSOR.gain_e_per_dn + SENSOR.black_dn), 0, SENSOR.white_dn)
    return raw_dn.astype(np.uint16)[:, None, :]


def bound(middles: np.ndarray, width: float, height_e: float) -> np.ndarray:
    """Cramer-Rao deviation (n,) in frames with height, background and width unknown; clipped samples tell nothing."""
    phases = np.linspace(0, 1, 41)
    deviations = []
    for phase in phases:
        u = (np.arange(FRAMES) - FRAMES // 2 - phase) / width
        bell = np.exp(-0.5 * u * u)
        mean = height_e * bell + BACKGROUND_E
        v = mean + SENSOR.dark_variance_e2
        weight = np.where(mean < SENSOR.saturation_e, 1 / v + 0.5 / v**2, 0.0)
        slopes = np.stack([height_e * bell * u / width, height_e * bell, np.ones(FRAMES), height_e * bell * u * u])
        deviations.append(np.sqrt(np.linalg.inv((slopes * weight) @ slopes.T)[0, 0]))
    return np.interp(middles % 1, phases, deviations)


def _row(method: str, seconds: float, error: np.ndarray, deviation: np.ndarray) -> dict[str, object]:
    """Root mean square of the error over that of the bound, its distribution over each pulse's own bound."""
    known = np.isfinite(error)
    ratio = np.abs(error[known]) / deviation[known]
    median, p95, largest = (float(value) for value in np.percentile(ratio, (50, 95, 100)))
    rms = float(np.sqrt(np.mean(error[known] ** 2) / np.mean(deviation[known] ** 2)))
    return {"method": method, "seconds": seconds, "error": rms, "median": median, "p95": p95, "largest": largest,
            "measured": float(known.mean()), "outliers": float(np.mean(ratio > OUTLIER)),
            "sampling_error": rms / float(np.sqrt(2 * known.sum()))}  # fmt: skip


def sweep_speed(turns: int) -> tuple[dict[str, float], list[dict[str, object]]]:
    """Figures and rows of 200 frames of 1024 x 768; in turns, the best of each, so that a busy machine slows all."""
    frames = camera_sweep()
    found = {"ours": np.inf, "ours: maxima alone": np.inf, "parabola": np.inf}
    bandwidth = 0.0
    for _ in range(turns):
        bandwidth = max(bandwidth, read_bandwidth(2))
        found["ours: maxima alone"] = min(found["ours: maxima alone"], fastest(lambda: track_peaks(frames), 2))
        found["ours"] = min(found["ours"], fastest(lambda: peak_times(frames, SENSOR), 1))
    found["parabola"] = fastest(lambda: parabola(frames), 2)
    figures = {
        "stage1_bandwidth_share": frames.nbytes / found["ours: maxima alone"] / bandwidth,
        "full_gpx_frames_per_s": frames.size / found["ours"] / 1e9,
        "full_speedup_vs_numpy_parabola": found["parabola"] / found["ours"],
    }
    size = f"{SHAPE[1]}x{SHAPE[0]}, {SWEEP} frames"
    return figures, [{"speed": name, "seconds": seconds, "size": size} for name, seconds in found.items()]


def camera_sweep() -> np.ndarray:
    """A stripe of 1.5 frames that crosses the whole picture, 4000 electrons bright (t, h, w)."""
    rng = np.random.default_rng(4)
    crossing = np.linspace(10, SWEEP - 10, SHAPE[1]) + rng.uniform(-1, 1, SHAPE)
    noise = rng.normal(0, 2.0, (8, *SHAPE)).astype(np.float32)
    frames = np.empty((SWEEP, *SHAPE), np.uint16)
    for index, frame in enumerate(frames):
        near = np.abs(np.linspace(10, SWEEP - 10, SHAPE[1]) - index) < 9
        signal = np.zeros(SHAPE, np.float32)
        signal[:, near] = 1000 * np.exp(-0.5 * ((index - crossing[:, near]) / 1.5) ** 2)
        grain = noise[index % 8] * np.sqrt(1 + signal / 16)
        frame[:] = np.rint(SENSOR.black_dn + 10 + signal + grain)
    return frames
