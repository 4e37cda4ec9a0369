"""Relightable images: time and exactness of the fit, and what is lost by writing them to files.

`ptm_mpx_per_s`: million pixels fitted per second, 64 lights of 8 bit RGB in memory, in the fastest of several runs that
took turns with numpy's, because anything else the machine does only slows one down. `ptm_over_least_squares`: largest
deviation of a coefficient from least squares in double precision, over the largest coefficient; the worst over scenes,
bases and noise. `ptm_roundtrip_db_lost`: peak signal to noise against the pictures that were fitted to, before less
after a .ptm was written and read; the worst scene. Rows have both formats' other kinds, and photographs where they are.
"""

import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from processing.formats.ptm import read_ptm, write_ptm
from processing.formats.relight import read_relight, write_relight
from processing.formats.rti import read_rti, write_rti
from processing.formats.sequence import read_picture
from processing.materials.ptm import RANK_TOLERANCE, Values, as_lrgb, fit_ptm, reproduction_db
from processing.products import RelightableImage, ResidualBasis
from processing.products.arrays import Float64
from processing.products.relightable_image import evaluate_basis
from service.bench import Result
from tests.public_data import DATA
from tests.reference.ptm import board, dome

LIGHTS = 64
BASES = {"PTM": ResidualBasis.BIQUADRATIC, "HSH": ResidualBasis.HEMISPHERICAL}
UNIT = "dB of peak signal to noise"

Scene = tuple[str, Values, Float64]


def run(*, quick: bool) -> Result:
    """Speed on half a megapixel or two, files of small scenes."""
    scenes = list(_scenes(quick=quick))
    speed = _speed(0.5e6 if quick else 2e6, runs=5 if quick else 15)
    exact = [_exactness(scene, name) for scene in scenes for name in BASES]
    files = [row for scene in scenes for row in _files(scene)]
    figures = {
        "ptm_mpx_per_s": speed[0]["mpx_per_s"],
        "ptm_over_least_squares": max(row["error"] for row in exact),
        "ptm_roundtrip_db_lost": max(row["error"] for row in files if row["method"] == ".ptm"),
    }
    return Result(figures, [*speed, *exact, *files])


def _scenes(*, quick: bool) -> Iterator[Scene]:
    """Boards under domes that reach low or not, pictures of noise, and photographs where they are."""
    size = (90, 120) if quick else (300, 400)
    for seed in (11,) if quick else (11, 12, 13):
        for height, lowest in (("high", 0.3), ("low", 0.05)):
            lights = dome(LIGHTS, lowest)
            yield f"board {seed}, {height} lights", board(lights, size, seed), lights
    noise = np.random.default_rng(5).integers(0, 256, (LIGHTS, *size, 3), dtype=np.uint8)
    yield "noise", noise, dome(LIGHTS)
    yield from _photographs()


def _photographs() -> Iterator[Scene]:
    """The public photographs of a cat under twelve lights, if they are on this machine."""
    folder = DATA / "photometric-stereo"
    if (folder / "lights.txt").is_file():
        lights = np.loadtxt(folder / "lights.txt", skiprows=1)
        pictures = np.stack([read_picture(folder / "cat" / f"cat.{n}.tga") for n in range(len(lights))])
        yield "cat", pictures, lights / np.linalg.norm(lights, axis=1, keepdims=True)


def _speed(pixels: float, runs: int) -> list[dict[str, object]]:
    lights = dome(LIGHTS)
    small = board(lights, (100, 100))
    side = round(np.sqrt(pixels) / 100)
    pictures = np.ascontiguousarray(np.tile(small, (1, side, side, 1)))
    matrix = np.linalg.pinv(evaluate_basis(ResidualBasis.BIQUADRATIC, lights)).astype(np.float32) / 255
    methods: dict[str, Callable[[], object]] = {
        "PTM": lambda: fit_ptm(pictures, lights),
        "PTM, numpy": lambda: matrix @ pictures.reshape(LIGHTS, -1).astype(np.float32),
        "HSH": lambda: fit_ptm(pictures, lights, ResidualBasis.HEMISPHERICAL),
    }
    seconds: dict[str, list[float]] = {name: [] for name in methods}
    for _ in range(runs):
        for name, method in methods.items():
            begun = time.perf_counter()
            method()
            seconds[name].append(time.perf_counter() - begun)
    mpx = pictures[0, :, :, 0].size / 1e6
    return [
        {"method": name, "peer": name.endswith("numpy"), "size": f"{mpx:.1f} Mpx, {LIGHTS} lights",
         "mpx_per_s": mpx / min(taken), "seconds": min(taken), "seconds_median": float(np.median(taken)),
         "seconds_p95": float(np.percentile(taken, 95))}
        for name, taken in seconds.items()
    ]  # fmt: skip


def _exactness(scene: Scene, name: str) -> dict[str, object]:
    """Deviation from least squares in double precision: `error` is the worst over the peak."""
    told, values, lights = scene
    functions = evaluate_basis(BASES[name], lights)
    columns = values.reshape(len(values), -1) / 255.0
    expected = np.linalg.lstsq(functions, np.eye(len(lights)), rcond=RANK_TOLERANCE)[0] @ columns
    found = fit_ptm(values, lights, BASES[name]).image.coefficients.reshape(expected.shape)
    deviation = np.abs(found - expected) / np.abs(expected).max()
    return {"method": f"{name} fit", "parameter": "deviation from least squares", "value": told,
            "unit": "shares of the peak", "error": float(deviation.max()), "median": float(np.median(deviation)),
            "p95": float(np.percentile(deviation, 95))}  # fmt: skip


def _files(scene: Scene) -> Iterator[dict[str, object]]:
    """What each kind of file loses, and how near it comes to the pictures."""
    told, values, lights = scene
    fits = {name: fit_ptm(values, lights, basis).image for name, basis in BASES.items()}
    fits["LRGB"] = as_lrgb(fits["PTM"])
    kinds = {
        ".ptm": ("PTM", write_ptm, read_ptm), ".ptm, LRGB": ("LRGB", write_ptm, read_ptm),
        ".rti": ("HSH", write_rti, read_rti), "web, PTM": ("PTM", write_relight, read_relight),
        "web, HSH": ("HSH", write_relight, read_relight),
    }  # fmt: skip
    for kind, (fit, write, read) in kinds.items():
        back, size = _through(write, read, fits[fit])
        before, after = (reproduction_db(image, values, lights) for image in (fits[fit], back))
        yield {"method": kind, "parameter": "lost by writing", "value": told, "unit": UNIT, "error": before - after,
               "db": after, "bytes": size}  # fmt: skip


def _through(
    write: Callable[[Path, RelightableImage], None], read: Callable[[Path], RelightableImage], image: RelightableImage
) -> tuple[RelightableImage, int]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "image"
        write(path, image)
        files = [path] if path.is_file() else list(path.iterdir())
        return read(path), sum(file.stat().st_size for file in files)
