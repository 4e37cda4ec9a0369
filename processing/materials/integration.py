"""Heights on a grid from the steps between neighbours, those that contradict the others left out; in pixels."""

from dataclasses import dataclass

import numpy as np

from processing.materials.grid_springs import solve
from processing.products.arrays import Float64
from processing.robust import bulk_deviation

_ROUNDS = 12
_SETTLED = 1e-2  # root mean square change of heights that ends the rounds
_LEAST_SCALE = 0.01  # steps that miss by less are met alike
_DOUBTS = 3.0  # by how many of its deviations a step may miss; less, and doubtful surfaces tear where nothing ends
_PRECISION = 1e-4  # of the solver, relative to the forces


@dataclass(frozen=True, eq=False)
class Steps:
    """Rise to the right (y, x - 1) and down the rows (y - 1, x), and the weight of each; 0 where there is none.

    `flatness` is the cosine between surface and picture there: by it an error of a rise is one of the surface, whose
    typical deviation is `doubt`.
    """

    right: Float64
    down: Float64
    right_weight: Float64
    down_weight: Float64
    right_flatness: Float64
    down_flatness: Float64
    doubt: float

    def errors(self, height: Float64) -> tuple[Float64, Float64]:
        """By how much heights (y, x) miss the steps, square to the surface."""
        right = (np.diff(height, axis=1) - self.right) * self.right_flatness
        return right, (np.diff(height, axis=0) - self.down) * self.down_flatness


def heights(steps: Steps) -> Float64:
    """Heights (y, x) that meet the steps best, of those that contradict each other the fewest giving way (Cauchy)."""
    height = np.zeros((steps.right.shape[0], steps.down.shape[1]))
    right, down = steps.right_weight, steps.down_weight
    for _ in range(_ROUNDS):
        before = height
        height = solve((right, down), _load(right * steps.right, down * steps.down), before, _PRECISION)
        across, along = steps.errors(height)
        known = np.concatenate([across[steps.right_weight > 0], along[steps.down_weight > 0]])
        scale = max(bulk_deviation(known) if known.size else 1.0, _DOUBTS * steps.doubt, _LEAST_SCALE)
        right = steps.right_weight / (1 + (across / scale) ** 2)
        down = steps.down_weight / (1 + (along / scale) ** 2)
        if np.std(height - before) < _SETTLED:
            break
    return height


def _load(right: Float64, down: Float64) -> Float64:
    """What flows into each pixel (y, x) from forces along the steps."""
    load = np.zeros((right.shape[0], down.shape[1]))
    load[:, :-1] -= right
    load[:, 1:] += right
    load[:-1] -= down
    load[1:] += down
    return load
