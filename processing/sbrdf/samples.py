"""The samples that the analysis sees: a BTF with the cosine inside, scaled so that what is white lies near 1."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from processing.products.arrays import Float32, Float64
from processing.svd import BtfRows


class BtfViews(BtfRows, Protocol):
    """A BTF that is read by blocks of texel rows or view by view: `Btf` in memory or `StoredBtf` on disk."""

    def seen_from(self, view: int) -> Float32:
        """What one view sees under every light, (light, y, x, channel)."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Reflectance times the light's cosine, over `scale` (1/sr). NaN = not measured, infinite,
    or light or view not above.

    The apparent BRDF of a BTF holds the cosine: fitted so, grazing samples do not explode.
    """

    btf: BtfViews
    scale: float

    @classmethod
    def of(cls, btf: BtfViews, share: float = 0.999) -> "Samples":
        """Scaled by the value under which all but a thousandth of the samples seen from the top lie."""
        plain = cls(btf, 1.0)
        values = plain.seen_from(plain.top)
        positive = values[np.isfinite(values) & (values > 0)]
        return cls(btf, float(np.quantile(positive, share)) if positive.size else 1.0)

    @property
    def light_directions(self) -> Float64:
        """Unit vectors (light, 3)."""
        return self.btf.light_directions

    @property
    def view_directions(self) -> Float64:
        """Unit vectors (view, 3)."""
        return self.btf.view_directions

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of light, view, y, x, channel."""
        return self.btf.shape

    @property
    def top(self) -> int:
        """The view nearest to the normal."""
        return int(np.argmax(self.view_directions[:, 2]))

    def pairs(self) -> tuple[Float64, Float64]:
        """Light and view (light * view, 3) of every sample of a texel, in the order of `texels`."""
        lights, views = self.light_directions, self.view_directions
        return np.repeat(lights, len(views), axis=0), np.tile(views, (len(lights), 1))

    def row_spans(self) -> Iterator[slice]:
        """Spans of rows to read one after another."""
        return self.btf.row_spans()

    def texels(self, rows: slice) -> Float32:
        """Rows of texels, (texel, light * view, channel), contiguous."""
        block = self._scaled(self.btf.rows(rows), self.view_directions[:, 2][None, :, None, None, None] > 0)
        return np.ascontiguousarray(np.moveaxis(block, (0, 1), (2, 3))).reshape(-1, block.shape[0] * block.shape[1], 3)

    def seen_from(self, view: int) -> Float32:
        """What one view sees under every light, (light, y, x, channel)."""
        return self._scaled(self.btf.seen_from(view), bool(self.view_directions[view, 2] > 0))

    def _scaled(self, reflectance: Float32, above: NDArray[np.bool_] | bool) -> Float32:
        """Times the cosine, lights first in `reflectance`."""
        cosine = self.light_directions[:, 2].reshape(-1, *[1] * (reflectance.ndim - 1))
        factor = np.where(above & (cosine > 0), cosine / self.scale, np.nan).astype(np.float32)
        values = np.asarray(reflectance * factor, np.float32)
        values[np.isinf(values)] = np.nan
        return values
