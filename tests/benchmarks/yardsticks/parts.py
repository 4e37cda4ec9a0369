"""A benchmark of several parts."""

import importlib
from pathlib import Path

from service.bench import Result


def run_parts(folder: str, *, quick: bool) -> Result:
    """Figures and rows of all modules of a folder of benchmarks, each with its own `run(*, quick) -> Result`.

    Rows say their `part`. Raises ValueError where two parts give the same figure.
    """
    figures: dict[str, float] = {}
    rows: list[dict[str, object]] = []
    for path in sorted((Path(__file__).parents[1] / folder).glob("*.py")):
        part: Result = importlib.import_module(f"tests.benchmarks.{folder}.{path.stem}").run(quick=quick)
        if repeated := figures.keys() & part.figures.keys():
            raise ValueError(f"{path.name}: figures {sorted(repeated)} are another part's")
        figures |= part.figures
        rows += [{"part": path.stem, **row} for row in part.rows]
    return Result(figures, rows)
