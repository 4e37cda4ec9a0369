"""Environments from simulated photographs of known places, and what resampling does to their light.

`environment_relative_error`: light that is in another place or amount, over all light (half of it would be found where
it is not, half missing where it is). `sphere_relight_error`: root mean square error of a diffuse sphere lit by what was
recovered, over the mean of one lit by the truth. Both are the worst of all places whose brightest light the phone's
shortest exposure holds; those that it clips are rows that say so. No scale is fitted: the simulated camera's own unit
is used. `reflection_mask_iou`: mean over the places of intersection over union of the found and the true mask.
`cubemap_energy_error`: worst error of the integral over the sphere of panoramas, a sun of 1e5 among them; beside it,
what looking up each texel's middle alone would do.
"""

import tempfile
import time
from pathlib import Path

import numpy as np

from processing.environment.brackets import Bracket, ProbePhotograph, merge_brackets
from processing.environment.capture import CaptureOptions, environment_of
from processing.environment.equirectangular import Panorama, cubemap_of, panorama_of
from processing.environment.image_circle import find_circle
from processing.environment.reflections import find_reflections
from processing.errors import ImageError
from processing.products import Environment
from processing.products.light_environment import cube_directions
from service.bench import Result
from tests.benchmarks.yardsticks import phone_shots

SEED = 1
_CLIPPED = 1e-3  # of a picture's light: more is beyond the phone


def run(*, quick: bool) -> Result:
    """One small room; or every place at a larger picture."""
    height, radius_px, size = (128, 96.0, 16) if quick else (256, 200.0, 64)
    places = phone_shots.environments(height)
    chosen = {"room": places["room"]} if quick else places
    rows: list[dict[str, object]] = []
    for name, panorama in chosen.items():
        rows += _captured(name, panorama, radius_px, size)
    judged = [row for row in rows if row.get("judged")]
    energy = _energy(places, size)
    figures = {
        "environment_relative_error": max((float(str(row["error"])) for row in judged), default=float("nan")),
        "sphere_relight_error": max((float(str(row["sphere"])) for row in judged), default=float("nan")),
        "reflection_mask_iou": float(np.mean([float(str(row["mask_iou"])) for row in rows])),
        "cubemap_energy_error": max(float(str(row["energy"])) for row in energy if row["method"] == "ours"),
    }
    return Result(figures, [*rows, *energy])


def _captured(name: str, panorama: Panorama, radius_px: float, size: int) -> list[dict[str, object]]:
    with tempfile.TemporaryDirectory() as folder:
        shots = phone_shots.photograph(panorama, Path(folder), seed=SEED, radius_px=radius_px)
        start = time.perf_counter()
        photographs = merge_brackets(Bracket(shots.front), Bracket(shots.back))
        merged_s = time.perf_counter() - start
    circles = find_circle(photographs[0].luminance), find_circle(photographs[1].luminance)
    found = find_reflections(photographs[0].picture, photographs[1].picture, circles)
    iou = float((found.front & shots.mask).sum() / (found.front | shots.mask).sum())
    base: dict[str, object] = {"place": name, "size": f"6 x {size} x {size}, circle of {radius_px:g} px",
                               "mask_iou": iou, "clipped_light": shots.clipped}  # fmt: skip
    rows = []
    for method, options in (
        ("as found", CaptureOptions(phone_shots.FIELD_RAD, size)),
        ("reflections marked by hand", CaptureOptions(phone_shots.FIELD_RAD, size, mask=shots.mask)),
        ("reflections left in", CaptureOptions(phone_shots.FIELD_RAD, size, detect=False)),
    ):
        start = time.perf_counter()
        row = base | {"method": method} | _errors(photographs, options, shots)
        rows.append(row | {"seconds": merged_s + time.perf_counter() - start})
    rows[0]["judged"] = "error" in rows[0] and shots.clipped < _CLIPPED
    return rows


def _errors(
    photographs: tuple[ProbePhotograph, ProbePhotograph], options: CaptureOptions, shots: phone_shots.PhoneShots
) -> dict[str, object]:
    try:
        captured = environment_of(photographs, options)
    except ImageError as error:
        return {"refused": str(error)}
    found = Environment(
        (captured.environment.radiance * shots.unit).astype(np.float32), captured.environment.provenance
    )
    truth = shots.truth(options.size)
    weight = truth.solid_angles[..., None]
    misplaced = (weight * np.abs(found.radiance - truth.radiance)).sum() / (weight * truth.radiance).sum()
    normals = cube_directions(6).reshape(-1, 3)
    ours, true = found.irradiance(normals), truth.irradiance(normals)
    turn = shots.world_from_front.T @ shots.world_from_back @ captured.registration.front_from_back.T
    return {
        "error": float(misplaced),
        "sphere": float(np.sqrt(np.mean((ours - true) ** 2)) / true.mean()),
        "sphere_worst": float(np.abs(ours / true - 1).max()),
        "turn_error_deg": float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))),
        "exposure_ratio": captured.registration.exposure_ratio,
    }


def _energy(places: dict[str, Panorama], size: int) -> list[dict[str, object]]:
    rows: list[dict[str, object]] = []
    sun = np.full_like(places["sky"].picture, 0.3)
    sun[sun.shape[0] // 5, 7] = 1e5
    for name, panorama in {**places, "sun of 1e5": Panorama(sun)}.items():
        truth = panorama.solid_angles @ panorama.radiance
        start = time.perf_counter()
        cubemap = cubemap_of(panorama, size)
        seconds = time.perf_counter() - start
        back = panorama_of(cubemap, panorama.picture.shape[0] // 2)
        ways = {"ours": cubemap.integral, "ours, back to a panorama": back.solid_angles @ back.radiance}
        index, weight = panorama.taps(cube_directions(size).reshape(-1, 3))
        middle = np.einsum("nt,ntc->nc", weight, panorama.radiance[index]).reshape(6, size, size, 3)
        ways["middle of each texel"] = Environment(middle.astype(np.float32)).integral
        for method, integral in ways.items():
            error = float(np.abs(integral / truth - 1).max())
            row = {"method": method, "place": name, "energy": error, "peer": method.startswith("middle")}
            rows.append(row | ({"seconds": seconds} if method == "ours" else {}))
    return rows
