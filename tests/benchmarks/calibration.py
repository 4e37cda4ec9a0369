"""Calibration: cameras, axis, sensor, lamps and response against truth, bounds and peers.

Every module of the folder `calibrations` measures one part by its own `run(*, quick) -> Result`; figures and rows of
all are joined here. A figure whose data are not on this machine is missing, and a row says why.
"""

import importlib
from pathlib import Path

from service.bench import Result


def run(*, quick: bool) -> Result:
    """Run every part; quick with fewer seeds."""
    figures: dict[str, float] = {}
    rows: list[dict[str, object]] = []
    for path in sorted((Path(__file__).parent / "calibrations").glob("*.py")):
        part: Result = importlib.import_module(f"tests.benchmarks.calibrations.{path.stem}").run(quick=quick)
        if repeated := figures.keys() & part.figures.keys():
            raise ValueError(f"{path.name}: figures {sorted(repeated)} are another part's")
        figures |= part.figures
        rows += [{"part": path.stem, **row} for row in part.rows]
    return Result(figures, rows)
