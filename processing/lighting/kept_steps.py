"""Step functions of vertices that are kept from frame to frame."""

import numpy as np
from numpy.typing import NDArray

from processing.lighting.kept_runs import KeptRuns
from processing.lighting.moving_kernel import Steps

Int64 = NDArray[np.int64]


class KeptSteps(KeptRuns):
    """Of `count` vertices, those that were added and not forgotten since."""

    def __init__(self, count: int) -> None:
        super().__init__(count, np.uint16, np.float32)

    def add(self, vertices: Int64, parts: list[Steps]) -> None:
        """Keep the steps of vertices, part after part in their order."""
        self.keep(vertices, [(part.end - part.begin, part.start, part.value) for part in parts])

    def steps(self, vertices: Int64) -> Steps:
        """Those of vertices that are all kept."""
        return Steps(*self.bounds(vertices), *self.columns)
