"""BTF + MDF: factors, silhouettes and shadows against ray-traced truth; frames, bytes, and other ways to draw relief.

The parts are the modules of the folder `btf_mdfs`. A figure whose data are not on this machine is missing, and a row
says why.
"""

from service.bench import Result
from tests.benchmarks.yardsticks.parts import run_parts


def run(*, quick: bool) -> Result:
    """Run every part; quick on smaller tiles, fewer directions and smaller pictures."""
    return run_parts("btf_mdfs", quick=quick)
