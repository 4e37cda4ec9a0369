"""How far a representation of a BTF is from the true one: over views, texels and rings, and as pictures look."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.products import Btf
from tests.benchmarks.yardsticks.btf_samples import ring_of
from tests.benchmarks.yardsticks.picture_difference import mean_flip, mean_ssim

Array = NDArray[Any]


@dataclass(frozen=True, eq=False)
class BtfErrors:
    """Squared errors of values with the cosine inside, over the mean square of the true ones.

    `views` (view,) are means over lights, texels and channels, `texels` (y, x) over lights, views and channels, `rings`
    by the view's polar angle in degrees. `flip` and `ssim` are means over pictures, `mse` is not over anything.
    """

    mse: float
    relative: float
    views: Array
    texels: Array
    rings: dict[int, float]
    flip: float
    ssim: float

    def spread(self) -> dict[str, float]:
        """Median, 90th percentile and worst over views and over texels."""
        levels = {"median": 50, "p90": 90, "worst": 100}
        return {
            f"{name}_{level}": float(np.percentile(values, percent))
            for name, values in (("view", self.views), ("texel", self.texels)) for level, percent in levels.items()
        }  # fmt: skip


def btf_errors(seen_from: Callable[[int], Array], true: Btf, pictures_per_ring: int = 3) -> BtfErrors:
    """Errors of what `seen_from(view)` (light, y, x, 3) gives, view by view; the truth has no missing samples."""
    lights, count = true.light_directions, true.shape[1]
    cosine = lights[:, 2].astype(np.float32)[:, None, None, None]
    square, views, texels = 0.0, np.empty(count), np.zeros(true.shape[2:4])
    shown = dict(_pictures(true, pictures_per_ring))
    pictures = []
    for view in range(count):
        wanted = true.seen_from(view) * cosine
        found = seen_from(view)
        errors = np.square(found - wanted, dtype=np.float64)
        views[view], texels = errors.mean(), texels + errors.mean(axis=(0, 3)) / count
        square += float(np.square(wanted, dtype=np.float64).mean()) / count
        pictures += [(wanted[light], found[light]) for light in shown.get(view, ())]
    ring = ring_of(true.view_directions)
    rings = {int(polar): float(views[ring == polar].mean() / square) for polar in np.unique(ring)}
    pairs = tuple(np.stack(some) for some in zip(*pictures, strict=True))
    return BtfErrors(
        float(views.mean()), float(views.mean() / square), views / square, texels / square, rings,
        mean_flip(*pairs), mean_ssim(*pairs),
    )  # fmt: skip


def _pictures(true: Btf, count: int) -> list[tuple[int, list[int]]]:
    """The first view of each ring, under lights spread over all rings but the lowest."""
    ring = ring_of(true.view_directions)
    views = [int(np.flatnonzero(ring == polar)[0]) for polar in np.unique(ring)]
    lights = np.linspace(0, 0.7 * (true.shape[0] - 1), count).astype(int).tolist()
    return [(view, lights) for view in views]
