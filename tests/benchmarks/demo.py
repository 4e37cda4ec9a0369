"""First light: everything from capture plans to lit pictures, on the simulated rig."""

import tempfile
from pathlib import Path

from service.bench import Result
from service.console import ConsoleProgress
from service.demo import run_demo


def run(*, quick: bool) -> Result:
    """The demo has one size: `quick` changes nothing."""
    with tempfile.TemporaryDirectory(prefix="rig-bench-") as folder, ConsoleProgress() as progress:
        report = run_demo(Path(folder) / "demo", seed=1, progress=progress)
    rows = [{"method": stage.title, "seconds": stage.wall_s} for stage in report.stages]
    return Result(report.figures, rows)
