"""Response curves of simulated JPEG cameras, ours beside OpenCV's Debevec and Robertson.

Curves, scenes, brackets and camera are none of those in the tests, with which the recovery was made.
"""

import time
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from processing.radiometry.response import recover_response
from service.bench import Result
from simulators.picture import HELD_OUT_CURVES, PictureCamera, log_exposure
from tests.processing.radiometry.pictures import SENSITIVITY, bracket, curve_rms

Array = NDArray[np.float64]
_BRACKETS = {
    "2 exposures, 1 1/2 stops": 2.0 ** np.array([-1.0, 0.5]),
    "3 exposures, 1 stop": 2.0 ** np.arange(-1, 2),
    "4 exposures, 2 2/3 stops": 2.0 ** (np.arange(-2, 2) * 8 / 3 + 1),
    "7 exposures, 1 1/3 stops": 2.0 ** (np.arange(-3, 4) * 4 / 3),
    "5 exposures, uneven": np.array([0.02, 0.11, 0.4, 2.7, 9.0]),
}
_QUICK = ("4 exposures, 2 2/3 stops",)
_CAMERA = {"full_e": 12_000.0, "read_noise_e": 8.0, "white_balance": (1.6, 1.0, 2.1), "quality": 88}
_CAMERA |= {"subsampling": "4:2:2", "sensitivity": SENSITIVITY}


def _scene(seed: int, shape: tuple[int, int] = (240, 320)) -> Array:
    """Radiance about 1 (h, w, 3): light that falls as nature's does at all scales, and round things before it."""
    rng = np.random.default_rng((731, seed))
    grain = [gaussian_filter(rng.normal(size=shape), 2.0**octave) * 2.0**octave for octave in range(1, 7)]
    log_radiance = 2.2 * sum(grain) / np.std(sum(grain))
    tint = np.stack([gaussian_filter(rng.normal(size=shape), 20) for _ in range(3)], axis=-1)
    log_radiance = log_radiance[..., None] + 0.3 * tint / tint.std()
    rows, columns = np.indices(shape)
    for _ in range(20):
        y, x, radius = rng.uniform(0, shape[0]), rng.uniform(0, shape[1]), rng.uniform(8, 30)
        inside = (rows - y) ** 2 + (columns - x) ** 2 < radius**2
        log_radiance[inside] = rng.normal(0, 2) + rng.normal(0, 0.4, 3) + 0.03 * (columns - x)[inside, None]
    return np.asarray(np.exp(log_radiance - np.median(log_radiance)), np.float64)


def _ours(stack: NDArray[np.uint8], times: Array) -> Array:
    return recover_response(stack, times)[0].log_exposure


def _opencv(maker: Callable[[], cv2.CalibrateCRF]) -> Callable[[NDArray[np.uint8], Array], Array]:
    def curve(stack: NDArray[np.uint8], times: Array) -> Array:
        found = maker().process(list(stack), times.astype(np.float32))[:, 0].astype(np.float64)
        return np.log(np.maximum(found, 1e-9))

    return curve


_METHODS = {
    "ours": _ours,
    "OpenCV Debevec": _opencv(lambda: cv2.createCalibrateDebevec(samples=300)),
    "OpenCV Robertson": _opencv(cv2.createCalibrateRobertson),
}


def run(*, quick: bool) -> Result:
    """`response_curve_rmse`: median over curves and brackets; its worst, and the peers'."""
    first = np.array([0.5, 1.0])
    _ours(bracket(PictureCamera(**_CAMERA), _scene(0), first), first)  # compiled before it is timed
    rows: list[dict[str, object]] = []
    errors: dict[str, list[float]] = {method: [] for method in _METHODS}
    for number, curve in enumerate(HELD_OUT_CURVES):
        truth = log_exposure(curve)
        for name, times in _BRACKETS.items():
            if quick and name not in _QUICK:
                continue
            stack = bracket(PictureCamera(curve, **_CAMERA), _scene(number), times, seed=number)
            for method, solve in _METHODS.items():
                start = time.perf_counter()
                found = curve_rms(solve(stack, times), truth)
                seconds = time.perf_counter() - start
                errors[method].append(found)
                rows.append(
                    {"method": method, "curve": curve, "bracket": name, "seconds": seconds, "error": found}
                    | ({} if method == "ours" else {"peer": True})
                )
    ours = errors["ours"]
    figures = {
        "response_curve_rmse": float(np.median(ours)),
        "response_curve_rmse_worst": max(ours),
        "peer_response_curve_rmse_debevec": float(np.median(errors["OpenCV Debevec"])),
        "peer_response_curve_rmse_robertson": float(np.median(errors["OpenCV Robertson"])),
        "response_better_than_peers": float(np.mean(np.array(ours) < np.min([*list(errors.values())[1:]], axis=0))),
    }
    return Result(figures, rows)
