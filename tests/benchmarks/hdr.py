"""HDR merge: error over the Cramer-Rao bound, bias, variance and run time, with other packages on the same stacks.

Stacks and bound: `yardsticks/hdr_stack.py`; peers and their settings: `yardsticks/hdr_peers.py`. All errors are over
the bound of each pixel, so that 1 is the smallest that an unbiased estimate can have.
"""

import time
from itertools import pairwise

import numpy as np

from processing.radiometry.adaptive import SHARE, merge_adaptively
from processing.radiometry.hdr import merge_exposures
from service.bench import Result
from tests.benchmarks.yardsticks.bandwidth import fastest, read_bandwidth
from tests.benchmarks.yardsticks.hdr_peers import PEERS, Peer
from tests.benchmarks.yardsticks.hdr_stack import EXPOSURE_S, SENSOR, bound_e_s, photograph, ramp

SMALL, LARGE = (768, 1024), (1920, 2560)
GROUPS = 64
BRIGHT_E_S = 100.0
DECADES_E_S = (1.5, 10, 100, 1e3, 1e4, 1e5, 4.31e5)


def run(*, quick: bool) -> Result:
    """Measure at 1024x768 and 2560x1920; quick with fewer repeats, and at the large size only the fastest peers."""
    accuracy, _, rows = compare(SMALL, ours=12 if quick else 64, peers=2 if quick else 8)
    ours = accuracy.pop("ours")
    figures = accuracy_figures(ours)
    rows += [
        {"figure": name, "value": figures[name], "sampling_error": deviation}
        for name, deviation in sampling_errors(ours).items()
    ]
    figures |= {f"peer_rmse_over_crb_{name}": float(found.rmse_over_crb) for name, found in accuracy.items()}
    fast = {"hdrutils", "opencv_debevec_u16", "opencv_robertson_u16"}
    _, seconds, large = compare(LARGE, ours=3, peers=3, only=fast if quick else None)
    part = read_in_part(LARGE, stacks=3)
    figures["adaptive_read_ratio"] = part["read_ratio"]
    return Result(figures | _speed_figures(seconds), [*rows, *large, part])


class Accuracy:
    """Sums over merged images, per column of one radiance, of the errors and the predicted variances."""

    def __init__(self, radiance: np.ndarray) -> None:
        self.radiance = radiance
        self.bound = bound_e_s(radiance)
        self.pixels = 0
        # Per column: pixels with a value, (error / bound)^2, error / radiance, variance / bound^2.
        self.finite, self.squares, self.shifts, self.predicted = np.zeros((4, len(radiance)))

    def add(self, value, variance):
        """Take one merged image; pixels without a value count as missing."""
        error = np.asarray(value, np.float64) - self.radiance
        self.pixels += error.size
        self.finite += np.isfinite(error).sum(axis=0)
        self.squares += np.nansum((error / self.bound) ** 2, axis=0)
        self.last = error / self.radiance
        self.shifts += np.nansum(self.last, axis=0)
        if variance is not None:
            self.predicted += np.nansum(variance / self.bound**2, axis=0)

    def groups(self, sums):
        """Means over 64 groups of equally many radiances."""
        return np.array([part.sum() for part in np.array_split(sums, GROUPS)]) / [
            part.sum() for part in np.array_split(self.finite, GROUPS)
        ]

    def percentiles(self):
        """The 5th, 50th and 95th of the last image's relative error, by decade of radiance."""
        found = {}
        for low, high in pairwise(DECADES_E_S):
            inside = (low <= self.radiance) & (self.radiance < high)
            found[f"{low:g}-{high:g}"] = np.nanpercentile(self.last[:, inside], (5, 50, 95)).tolist()
        return found

    @property
    def rmse_over_crb(self):
        return np.sqrt(self.squares.sum() / self.finite.sum())

    @property
    def group_rmse(self):
        return np.sqrt(self.groups(self.squares))

    @property
    def bias_bright(self):
        """Largest relative bias of a group above 100 e-/s."""
        lowest = np.array([part[0] for part in np.array_split(self.radiance, GROUPS)])
        return np.abs(self.groups(self.shifts)[lowest > BRIGHT_E_S]).max()

    @property
    def bias_dark(self):
        """Mean relative error in the darkest decade."""
        dark = self.radiance < 10 * self.radiance[0]
        return abs(self.shifts[dark].sum() / self.finite[dark].sum())

    @property
    def variance_ratio(self):
        """Predicted over observed variance, over all pixels."""
        return self.predicted.sum() / self.squares.sum()


def compare(shape, *, ours, peers, only=None):
    """Accuracy and best run time by method, and a row for each.

    `ours` and `peers` say how many stacks each merges; `only` names the peers that take part.
    """
    wanted = [peer for peer in PEERS if only is None or peer.name in only]
    missing = [{"method": peer.name, "missing": peer.missing()} for peer in wanted if peer.missing()]
    methods = (OURS, *(peer for peer in wanted if not peer.missing()))
    radiance = ramp(shape[1])
    accuracy = {method.name: Accuracy(radiance) for method in methods}
    seconds = dict.fromkeys(accuracy, np.inf)
    rng = np.random.default_rng(11)
    for repeat in range(max(ours, peers)):
        raw_dn = photograph(rng, shape[0], radiance)
        for method in methods:
            if repeat < (ours if method is OURS else peers):
                start = time.perf_counter()
                merged = method.merge(raw_dn)
                seconds[method.name] = min(seconds[method.name], time.perf_counter() - start)
                accuracy[method.name].add(*(merged if method is OURS else (merged, None)))
    rows = [
        {"method": method.name, "size": f"{shape[1]}x{shape[0]}", "seconds": seconds[method.name],
         "peer": method is not OURS, "reference": method.reference, "settings": method.settings,
         "version": method.version(),
         **_errors(accuracy[method.name])}
        for method in methods
    ]  # fmt: skip
    return accuracy, seconds, missing + rows


def _ours(raw_dn):
    merged = merge_exposures(raw_dn, EXPOSURE_S, SENSOR)
    return merged.value, merged.variance


OURS = Peer("ours", _ours, "the sensor's parameters")


def _errors(found):
    return {
        "error": float(found.rmse_over_crb),
        "bound": 1.0,
        "median_group": float(np.median(found.group_rmse)),
        "worst_group": float(found.group_rmse.max()),
        "bias_bright": float(found.bias_bright),
        "bias_dark": float(found.bias_dark),
        "missing_pixels": float(1 - found.finite.sum() / found.pixels),
        "relative_error_percentiles_5_50_95": found.percentiles(),
    }


def read_in_part(shape, *, stacks):
    """The row of the merge that decodes what tells something: its error, and the share of the samples that it reads."""
    found, seconds, ratio = Accuracy(ramp(shape[1])), np.inf, 0.0
    rng = np.random.default_rng(13)
    for _ in range(stacks):
        frames = list(photograph(rng, shape[0], found.radiance))
        start = time.perf_counter()
        merged = merge_adaptively(frames, EXPOSURE_S, SENSOR)
        seconds = min(seconds, time.perf_counter() - start)
        found.add(merged.radiance.value, merged.radiance.variance)
        ratio += merged.report.read_ratio / stacks
    return {
        "method": "ours, read in part", "size": f"{shape[1]}x{shape[0]}", "seconds": seconds, "read_ratio": ratio,
        "settings": f"results change by under {SHARE:g} of their deviation", **_errors(found),
    }  # fmt: skip


def accuracy_figures(found):
    return {
        "rmse_over_crb_all": float(found.rmse_over_crb),
        "rmse_over_crb_median": float(np.median(found.group_rmse)),
        "rmse_over_crb_worst": float(found.group_rmse.max()),
        "bias_max_bright": float(found.bias_bright),
        "bias_dark": float(found.bias_dark),
        "variance_ratio": float(found.variance_ratio),
    }


def sampling_errors(found):
    """How far chance alone moves each figure (one standard deviation), from the number of pixels behind it."""
    per_group, relative = found.pixels / GROUPS, found.bound / found.radiance
    dark = found.radiance < 10 * found.radiance[0]
    deviations = {
        "rmse_over_crb_all": (2 * found.pixels) ** -0.5,
        "rmse_over_crb_median": 1.25 * (2 * found.pixels) ** -0.5,
        "rmse_over_crb_worst": (2 * per_group) ** -0.5,
        "bias_max_bright": relative[found.radiance > BRIGHT_E_S].max() * per_group**-0.5,
        "bias_dark": (np.mean(relative[dark] ** 2) / (found.pixels * dark.mean())) ** 0.5,
        "variance_ratio": (2 / found.pixels) ** 0.5,
    }
    return {name: float(deviation) for name, deviation in deviations.items()}


def _speed_figures(seconds):
    """Run time at the large size: against peers over as many stacks, and against reading the stack once.

    Bandwidth and run time are measured in turns; the best of each is what the machine can do.
    """
    raw_dn = photograph(np.random.default_rng(12), LARGE[0], ramp(LARGE[1]))
    turns = [(read_bandwidth(3), fastest(lambda: _ours(raw_dn), 3)) for _ in range(5)]
    bandwidth, ours = max(turn[0] for turn in turns), min(turn[1] for turn in turns)
    figures = {
        "time_over_bandwidth_floor": ours / (raw_dn.nbytes / bandwidth),
        "ns_per_pixel_frame": ours / raw_dn.size * 1e9,
        "read_bandwidth_gb_s": bandwidth / 1e9,
        "speedup_vs_opencv": min(spent for name, spent in seconds.items() if name.startswith("opencv"))
        / seconds["ours"],
    }
    return figures | ({"speedup_vs_hdrutils": seconds["hdrutils"] / seconds["ours"]} if "hdrutils" in seconds else {})
