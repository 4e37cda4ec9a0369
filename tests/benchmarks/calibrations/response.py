"""Response curves of simulated JPEG cameras, ours beside OpenCV's Debevec and Robertson."""

import time
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from processing.radiometry.response import recover_response
from service.bench import Result
from simulators.picture import CURVES, log_exposure
from tests.processing.radiometry.pictures import bracket, camera, scene

Array = NDArray[np.float64]
_INSIDE = slice(20, 236)  # what every method determines
_BRACKETS = {
    "2 exposures, 1 stop": 2.0 ** np.arange(-1, 1),
    "3 exposures, 2 stops": 4.0 ** np.arange(-1, 2),
    "5 exposures, 2 stops": 4.0 ** np.arange(-2, 3),
    "9 exposures, 2/3 stop": 2.0 ** (np.arange(-4, 5) * 2 / 3),
    "4 exposures, uneven": np.array([0.03, 0.09, 1.5, 5.7]),
}
_QUICK = ("5 exposures, 2 stops", "9 exposures, 2/3 stop")


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


def curve_rms(curve: Array, truth: Array) -> float:
    """Error of ln(exposure) over codes and channels; a factor per channel is free."""
    error = (curve - truth)[_INSIDE]
    return float(np.sqrt(np.mean((error - error.mean(axis=0)) ** 2)))


def run(*, quick: bool) -> Result:
    """`response_curve_rmse`: median over curves and brackets; its worst, and the peers'."""
    _ours(bracket(camera(), scene(9), np.array([0.5, 1.0])), np.array([0.5, 1.0]))  # compiled before it is timed
    rows: list[dict[str, object]] = []
    errors: dict[str, list[float]] = {method: [] for method in _METHODS}
    for curve in CURVES:
        truth = log_exposure(curve)
        for name, times in _BRACKETS.items():
            if quick and name not in _QUICK:
                continue
            stack = bracket(camera(curve), scene(0, (240, 320)), times)
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
