"""Lighting design: capture of an environment, precomputed visibility cuts, relighting of scenes whose bodies move.

The parts are the modules of the folder `relights`.
"""

from service.bench import Result
from tests.benchmarks.yardsticks.parts import run_parts


def run(*, quick: bool) -> Result:
    """Run every part; quick on few vertices and coarse fields."""
    return run_parts("relights", quick=quick)
