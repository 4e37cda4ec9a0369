"""Spheres found in simulated pictures, and their reflectance maps against truth.

`sphere_centre_px`, `sphere_radius_px`: the largest distance between found and true centre, and error of the radius,
over rigs, materials and cameras: the front camera with the arm's lights, one that looks down and one at 50 deg with the
arc's. Rows: their distribution; the maps' error, relative to the largest true value, also with the paper's assumption
that the camera is distant. Cameras are as rig.toml has them; nothing was calibrated.
"""

import time

import numpy as np

from service.bench import Result
from tests.benchmarks.yardsticks.sphere_shots import SphereShots, find_in

MATERIALS = ("sphere", "sphere-glaze", "sphere-wax", "sphere-cloth")
SEEDS = 1, 2, 3  # of simulated rigs; the search for the limb was made with others
ARM = tuple(("led", float(angle)) for angle in (-60, -30, -10, 10, 30, 60))
DOME = tuple((lamp, azimuth) for lamp in ("lamp0", "lamp3", "lamp6") for azimuth in (-150.0, -30.0, 30.0, 150.0))
CAMERAS = {"front": ARM, "cam7": DOME, "cam3": DOME}
SIZE = 64  # texels of three pixels: what a texel shows is what its camera can tell apart


def run(*, quick: bool) -> Result:
    """Three rigs; quick one of them, from above the stone and nothing at 50 deg."""
    found, maps, hard = [], [], []
    for number, (seed, material, camera, lights) in enumerate(_quick() if quick else _all()):
        shots = SphereShots(seed, material, camera, lights)
        found.append(circle_errors(shots))
        if not quick or number == 0:
            maps += [map_errors(shots, orthographic=distant) for distant in (False, True)]
        if not hard:
            hard = hard_cases(shots)
    figures = {
        "sphere_centre_px": max(row["centre_px"] for row in found),
        "sphere_radius_px": max(abs(row["radius_px"]) for row in found),
    }
    return Result(figures, [*spread(found), *found, *maps, *hard])


def _all():
    return [(s, m, camera, lights) for s in SEEDS for m in MATERIALS for camera, lights in CAMERAS.items()]


def _quick():
    return [(1, m, "front", ARM[::2]) for m in MATERIALS] + [(1, "sphere", "cam7", DOME[::2])]


def circle_errors(shots: SphereShots) -> dict[str, object]:
    """Of one sphere, with what the search says of itself."""
    mosaics = shots.mosaics
    start = time.perf_counter()
    found = find_in(mosaics)
    spent_s = time.perf_counter() - start
    centre_px, radius_px = shots.circle
    return {
        "method": "limb of all lights", "input": _name(shots), "seconds": spent_s,
        "centre_px": float(np.linalg.norm(found.centre_px - centre_px)), "radius_px": found.radius_px - radius_px,
        "centre_sigma_px": float(np.hypot(*found.sigma_px[:2])), "radius_sigma_px": float(found.sigma_px[2]),
    }  # fmt: skip


def spread(found: list[dict[str, object]]) -> list[dict[str, object]]:
    """Median, 95th percentile and worst over all spheres."""
    rows = []
    for name in ("centre_px", "radius_px"):
        errors = np.abs([row[name] for row in found])
        rows.append({"distribution of": name, "spheres": len(found), **_distribution(errors)})
    return rows


def map_errors(shots: SphereShots, *, orthographic: bool) -> dict[str, object]:
    """Of the maps of all lights, in shares of the largest true value."""
    measured, true = shots.maps(SIZE, orthographic=orthographic).reflectance_cos, shots.true_maps(SIZE)
    both = np.isfinite(measured) & np.isfinite(true)
    error = np.abs(measured - true)[both] / np.nanmax(true)
    return {
        "method": "maps, camera taken as distant" if orthographic else "maps", "input": _name(shots),
        "rms": float(np.sqrt(np.mean(error**2))), **_distribution(error),
        "brightness": float(measured[both].sum() / true[both].sum()), "measured": float(np.isfinite(measured).mean()),
    }  # fmt: skip


def hard_cases(shots: SphereShots) -> list[dict[str, object]]:
    """The same pictures with the sphere cut by a border, and with the light of one side alone."""
    value, variance = shots.mosaics
    centre_px, radius_px = shots.circle
    cut = 2 * int((centre_px[0] - 0.4 * radius_px) // 2)  # even, so that the mosaic's colours stay
    cases = {
        "cut by the border": (find_in((value[..., cut:], variance[..., cut:])), cut),
        "one light": (find_in((value[:1], variance[:1])), 0),
    }
    return [
        {"method": f"limb, {case}", "input": _name(shots), "radius_px": found.radius_px - radius_px,
         "centre_px": float(np.linalg.norm(found.centre_px + np.array([left, 0]) - centre_px))}
        for case, (found, left) in cases.items()
    ]  # fmt: skip


def _distribution(errors: np.ndarray) -> dict[str, float]:
    median, p95, worst = map(float, np.percentile(errors, (50, 95, 100)))
    return {"median": median, "p95": p95, "worst": worst}


def _name(shots: SphereShots) -> str:
    return f"{shots.sample}, {shots.camera}, {len(shots.lights)} lights, rig {shots.seed}"
