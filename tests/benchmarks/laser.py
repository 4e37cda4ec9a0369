"""Laser range: peak times, planes and displacements against truth, bounds and other estimators on the same frames.

The parts are the modules of the folder `lasers`. A figure whose data are not on this machine is missing, and a row says
why.
"""

from service.bench import Result
from tests.benchmarks.yardsticks.parts import run_parts


def run(*, quick: bool) -> Result:
    """Run every part; quick on fewer pixels and values."""
    return run_parts("lasers", quick=quick)
