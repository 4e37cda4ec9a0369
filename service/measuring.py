"""Commands that work on files: merging photographs, benchmarks. Each yields the lines that it tells."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from processing.errors import ImageError
from processing.radiometry.bracket import MergedImage, PhotographExposures, balanced, merge_files, write_merged
from processing.radiometry.exposure import TimesVerdict
from processing.radiometry.hdr import PixelStatus
from processing.radiometry.response_file import read_response
from processing.radiometry.sensor_calibration import SensorCalibration
from processing.radiometry.stack import DEFAULTS, MergedExposures, MergeOptions
from service import bench
from service.bench_curves import draw_curves
from service.bench_report import draw_report
from service.files import replaced

_EXPOSURE_NEWS = 0.02  # log exposure: smaller departures are not worth a line
NOTICED = 0.01  # share of a picture that moved from which on it is told


def merge_photographs(
    files: Sequence[Path],
    out: Path,
    options: MergeOptions = DEFAULTS,
    sensor: Path | None = None,
    response: Path | None = None,
    grey: str = "",
) -> Iterator[str]:
    """Merge a bracket into `out` (.exr) and a PNG beside it, of JPEG also the camera's response (.json).

    `sensor` is the product folder of a measured sensor, `response` a file of an earlier merge; `grey` is the box of a
    grey patch, LEFT,TOP,WIDTH,HEIGHT in pixels. Raises ImageError, CalibrationError.
    """
    box_px = _box(grey) if grey else None
    known = None if response is None else read_response(response)
    merged = merge_files(files, options, None if sensor is None else SensorCalibration.load(sensor), known)
    if box_px is not None:
        merged = balanced(merged, box_px)
    with replaced(out) as part:
        write_merged(merged, part)
    times = ", ".join(f"{time_s:.4g}" for time_s in merged.exposure_s)
    saturated = merged.radiance.count(PixelStatus.SATURATED) / merged.radiance.status.size
    camera = merged.camera or "an unnamed camera"
    yield f"{len(files)} exposures of {camera} ({times} s); {saturated:.2%} saturated in all of them"
    if merged.assumed_sensor:
        yield "No noise profile in the files: gain and read noise are assumed, the variance is only indicative."
    if merged.found is not None:
        yield from _about_frames(merged.found, [path.name for path in merged.files])
    if merged.photographs is not None:
        yield from _about_photographs(merged, merged.photographs, known=known is not None)
    if merged.balance is not None:
        red, green, blue = merged.balance.multipliers
        yield f"White balance from the grey patch: red x {red:.4f}, green x {green:.0f}, blue x {blue:.4f}"
    yield f"{out}: linear, with layers variance and status"
    yield f"{out.with_suffix('.png')}: tone-mapped"
    if merged.response is not None:
        yield f"{out.with_suffix('.json')}: the camera's response, for --response"


def _box(text: str) -> tuple[int, int, int, int]:
    try:
        left, top, width, height = (int(edge) for edge in text.split(","))
    except ValueError as error:
        raise ImageError(f"grey patch {text!r}: four numbers are needed, LEFT,TOP,WIDTH,HEIGHT in pixels.") from error
    return left, top, width, height


def _about_photographs(merged: MergedImage, exposures: PhotographExposures, *, known: bool) -> Iterator[str]:
    """What the pictures of a bracket showed about their camera and their exposures."""
    if merged.response is not None and not known:
        middle = merged.response.log_exposure_sigma[20:236]
        yield f"Response of the camera recovered, to {np.sqrt(np.mean(middle**2)):.1%} of the light between its codes."
    error = np.log(np.divide(exposures.measured, exposures.stated))
    worst = int(np.abs(error).argmax())
    if abs(error[worst]) > _EXPOSURE_NEWS:
        yield (
            f"{merged.files[worst]} has {np.expm1(error[worst]):+.1%} exposure against what it states: flicker, or the "
            "shutter; the merge goes by the pictures."
        )


def _about_frames(found: MergedExposures, names: Sequence[str]) -> Iterator[str]:
    """What the frames of a RAW bracket showed about themselves."""
    times, read, shift = found.times, found.read, found.alignment.worst
    if times.verdict in (TimesVerdict.CORRECTED, TimesVerdict.CONTRADICTED):
        worst = int(np.abs(np.log(times.scale)).argmax())
        yield (
            f"Exposure times corrected by what the frames share, at most {times.scale[worst] - 1:+.2%} "
            f"+- {times.sigma[worst]:.2%} of {times.stated_s[worst]:.4g} s: flicker, or the shutter."
        )
    elif times.verdict == TimesVerdict.UNDETERMINED and len(times.stated_s) > 1:
        yield "No two exposures show the same part of the scene well: their stated times could not be checked."
    if shift is not None:
        yield f"The picture moved by {shift.length_px:.2f} px between {names[shift.one]} and {names[shift.other]}."
    elif found.alignment.moved_share > NOTICED:
        yield f"Something moved: in {found.alignment.moved_share:.1%} of the picture the exposures disagree."
    if read.read_ratio < 1:
        yield (
            f"{read.read_ratio:.0%} of the samples were read; {read.saturated.mean():.0%} are saturated, "
            f"{read.outweighed.mean():.0%} tell less than the other exposures."
        )


def benchmark(name: str, *, quick: bool, to: Path | None, as_json: bool, records: Path) -> Iterator[str]:
    """Run a benchmark, draw all records (`report`; `bench-NAME-curves.png` beside), or list what there is (no name).

    The record goes into the file `to`, or is told: whole as JSON, else its figures alone.
    Raises ConfigError for a name that there is not.
    """
    if not name:
        known = bench.benchmarks()
        width = max(12, *map(len, known))
        yield from (f"{key:{width}} {meaning}" for key, meaning in known.items())
        return
    if name == "report":
        found = sorted(records.glob("bench-*.json"))
        picture = records / "bench-report.png"
        yield f"{picture}: {draw_report(found, picture)} points from {len(found)} records"
        curves = ((record, record.with_name(f"{record.stem}-curves.png")) for record in found)
        yield from (f"{to}: errors over what was varied" for record, to in curves if draw_curves(record, to))
        return
    record = bench.run_benchmark(name, quick=quick)
    whole = json.dumps(record, indent=2)
    if to is not None:
        to.parent.mkdir(parents=True, exist_ok=True)
        to.write_text(whole + "\n", encoding="utf-8")
        yield str(to)
    elif as_json:
        yield whole
    else:
        yield from (f"  {figure:34} {value:.4g}" for figure, value in record["figures"].items())
