"""SBRDF+: fits of lobes, shadows, hidden points and shifts against truth; size, frames, and other representations.

The parts are the modules of the folder `sbrdfs`. A figure whose data are not on this machine is missing, and a row says
why.
"""

from service.bench import Result
from tests.benchmarks.yardsticks.parts import run_parts


def run(*, quick: bool) -> Result:
    """Run every part; quick on smaller tiles and fewer directions."""
    return run_parts("sbrdfs", quick=quick)
