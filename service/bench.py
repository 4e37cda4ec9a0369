"""Benchmarks of a checkout: what `rig bench` runs and writes."""

import importlib.util
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from rig.errors import ConfigError
from service.machine import machine, versions

CHECKOUT = Path(__file__).parents[1]
FOLDER = CHECKOUT / "tests" / "benchmarks"


@dataclass(frozen=True, slots=True)
class Result:
    """What one benchmark measured.

    `figures` are the named numbers; each row of `rows` is one method on one input. A row with `method`, `seconds` and
    `error` appears in the report, as a peer where `peer` is true, with the `size` of its input and the `bound` under
    its error where it names them. Rows with a `parameter` and its `value` are lines of a picture of their own, with the
    `unit` of the error and the share of values `measured` where they name them.
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
