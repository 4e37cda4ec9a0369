"""Sensors by photon transfer: gain and read noise against the simulated units' truth."""

import time
from collections.abc import Callable

import numpy as np

from processing.radiometry.photon_transfer import measure_sensor
from service.bench import Result
from tests.reference.sensor_frames import Camera

SHAPE = (240, 320)  # of the simulated rig's arc cameras
SATURATION_SHARE = 0.7  # up to which EMVA 1288 fits its line


def run(*, quick: bool) -> Result:
    """`gain_error` and `read_noise_error`: relative, of the worst of 8 units (quick: 3), 72 small frames each.

    Rows: root mean square over the units, beside the line through pairs of frames as EMVA 1288 fits it.
    """
    cameras = [Camera(seed, SHAPE) for seed in range(3 if quick else 8)]
    methods: dict[str, Callable[..., tuple[float, float]]] = {
        "weighted line, linearised": _ours,
        "pairs, plain line (EMVA 1288)": _pairs,
    }
    figures, rows = {}, []
    for method, measure in methods.items():
        errors, seconds = [], []
        for camera in cameras:
            frames = [[(t, list(repeats)) for t, repeats in series] for series in (camera.dark(), camera.flats())]
            begun_s = time.perf_counter()
            gain, read_noise_e = measure(camera, *frames)
            seconds.append(time.perf_counter() - begun_s)
            true = camera.unit.sensor
            errors.append((gain / true.gain_e_per_dn - 1, read_noise_e / true.read_noise_e - 1))
        rms, median, worst = _distribution(np.abs(errors))
        rows.append({
            "method": method, "seconds": min(seconds), "error": rms[0], "units": len(cameras),
            "gain_error": {"median": median[0], "largest": worst[0]},
            "read_noise_error": {"rms": rms[1], "median": median[1], "largest": worst[1]},
            "peer": measure is not _ours,
        })  # fmt: skip
        if measure is _ours:
            figures = {"gain_error": worst[0], "read_noise_error": worst[1]}
    return Result(figures, rows)


def _distribution(errors: np.ndarray) -> list[list[float]]:
    """Root mean square, median and largest of each column."""
    of_all = (np.sqrt(np.mean(errors**2, axis=0)), np.median(errors, axis=0), errors.max(axis=0))
    return [values.tolist() for values in of_all]


def _ours(camera: Camera, dark: list, flat: list) -> tuple[float, float]:
    found = measure_sensor(dark, flat, camera.stated).sensor
    return found.gain_e_per_dn, found.read_noise_e


def _pairs(camera: Camera, dark: list, flat: list) -> tuple[float, float]:
    """Two frames an exposure, half the variance of their difference, an unweighted line (release 4.0, section 6.6)."""
    shortest = [frame.raw_dn.astype(float) for frame in dark[-1][1][:2]]
    zero_dn, dark_dn2 = np.mean(shortest), np.var(shortest[0] - shortest[1]) / 2
    signal, variance = [], []
    green = np.s_[::2, 1::2]
    for _, frames in flat:
        first, second = (frame.raw_dn[green].astype(float) for frame in frames[:2])
        level = (first.mean() + second.mean()) / 2 - zero_dn
        if level < SATURATION_SHARE * (camera.stated.white_dn - zero_dn):
            signal.append(level)
            variance.append(np.var(first - second) / 2 - dark_dn2)
    gain = float(np.sum(np.square(signal)) / np.dot(signal, variance))
    return gain, gain * float(np.sqrt(max(dark_dn2 - 1 / 12, 0.0)))
