"""First light: everything from capture plans to lit pictures, on the simulated rig."""

import tempfile
from pathlib import Path

from rig.sessions import parse_plan, plan_data
from service.bench import Result
from service.console import ConsoleProgress
from service.demo import demo_plans, run_demo

# Half of the views and a quarter of the sweeps: every stage still runs, the figures are coarser.
QUICK = {
    "btf": {"turntable_deg": [0, 90]},
    "mdf": {"laser_elevations_deg": [50], "cameras": ["cam7"]},
}


def run(*, quick: bool) -> Result:
    """Run the demo; quick with fewer views of the brick and fewer laser sweeps."""
    plans = demo_plans()
    for kind, changes in QUICK.items() if quick else ():
        plans[kind] = parse_plan(plan_data(plans[kind]) | changes)
    with tempfile.TemporaryDirectory(prefix="rig-bench-") as folder, ConsoleProgress() as progress:
        report = run_demo(Path(folder) / "demo", plans, seed=1, progress=progress)
    rows = [{"method": stage.title, "seconds": stage.wall_s} for stage in report.stages]
    return Result(report.figures, rows)
