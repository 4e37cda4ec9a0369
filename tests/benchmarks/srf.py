"""SRF: error, size and time of eight representations of the same materials; fits, captures and frames against bounds.

The parts are the modules of the folder `srfs`. A figure whose data are not on this machine is missing, and a row says
why.
"""

from service.bench import Result
from tests.benchmarks.yardsticks.parts import run_parts


def run(*, quick: bool) -> Result:
    """Run every part; quick on smaller maps and fewer directions."""
    return run_parts("srfs", quick=quick)
