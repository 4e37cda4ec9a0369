"""Calibration: cameras, axis, sensor, lamps and response against truth, bounds and peers.

The parts are the modules of the folder `calibrations`. A figure whose data are not on this machine is missing, and a
row says why.
"""

from service.bench import Result
from tests.benchmarks.yardsticks.parts import run_parts


def run(*, quick: bool) -> Result:
    """Run every part; quick with fewer seeds."""
    return run_parts("calibrations", quick=quick)
