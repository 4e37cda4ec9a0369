"""Benchmarks of a checkout: what `rig bench` runs, writes and draws."""

import importlib.util
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from matplotlib.figure import Figure

from rig.errors import ConfigError
from service.machine import machine, versions

CHECKOUT = Path(__file__).parents[1]
FOLDER = CHECKOUT / "tests" / "benchmarks"


@dataclass(frozen=True, slots=True)
class Result:
    """What one benchmark measured.

    `figures` are the named numbers; each row of `rows` is one method on one input, with `method`, `seconds` and
    `error` where it is to appear in the report, and `peer` where it is another package's.
    """

    figures: Mapping[str, float]
    rows: Sequence[Mapping[str, object]] = ()


def benchmarks() -> dict[str, str]:
    """Name and first docstring line of every benchmark of this checkout."""
    found = {}
    for path in sorted(FOLDER.glob("*.py")):
        found[path.stem] = (_load(path).__doc__ or "").strip().splitlines()[0]
    return found


def run_benchmark(name: str, *, quick: bool) -> dict[str, Any]:
    """Run a benchmark and return its record. Raises ConfigError where there is no such benchmark."""
    path = FOLDER / f"{name}.py"
    if not path.is_file():
        known = ", ".join(benchmarks()) or "none: benchmarks run from a checkout of the source"
        raise ConfigError(f"no benchmark {name!r}; there are: {known}")
    measure: Callable[..., Result] = _load(path).run
    result = measure(quick=quick)
    return {
        "bench": name,
        "quick": quick,
        "figures": dict(result.figures),
        "rows": [dict(row) for row in result.rows],
        "machine": machine(),
        "versions": versions(),
    }


def draw_report(records: Sequence[Path], picture: Path) -> int:
    """Draw run time against error of every row that has both, one colour per benchmark, peers hollow; count them."""
    figure = Figure(figsize=(9, 6), layout="constrained")
    axes = figure.subplots()
    drawn = 0
    for path in records:
        record = json.loads(path.read_text())
        rows = [row for row in record["rows"] if "seconds" in row and "error" in row]
        for row in rows:
            filled = "none" if row.get("peer") else None
            points = axes.scatter(row["seconds"], row["error"], facecolors=filled, edgecolors=f"C{drawn % 10}")
            points.set_zorder(3)
            axes.annotate(f"{record['bench']}: {row['method']}", (row["seconds"], row["error"]), fontsize=8,
                          xytext=(5, 4), textcoords="offset points")  # fmt: skip
            drawn += 1
    axes.set(xscale="log", yscale="log", xlabel="run time in s", ylabel="relative error (hollow: peers)")
    axes.grid(alpha=0.3)
    figure.savefig(picture, dpi=120)
    return drawn


def _load(path: Path) -> ModuleType:
    # Benchmarks use the tests' forward models, and those of the simulators, by their names in the checkout.
    if str(CHECKOUT) not in sys.path:
        sys.path.insert(0, str(CHECKOUT))
    specification = importlib.util.spec_from_file_location(f"benchmark_{path.stem}", path)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module
