"""A BTF as photographs of one exposure would hold it: what is brighter than white is white.

A few glints are so bright that the terms of least squared error go to them, and all else loses its colour: with twelve
terms a glazed brick and its mortar become one. No picture shows a glint brighter than its white.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from processing.products import Provenance
from processing.products.arrays import Float32, Float64
from processing.products.btf import Block
from processing.svd import BtfRows

_SHARE = 0.99  # of the samples that white is not brighter than
_EVERY = 31  # sample is asked what is bright: prime, so that channels, texels and views take their turns


@dataclass(frozen=True, eq=False)
class Whitened:
    """A BTF, read block by block, whose reflectance times the light's cosine is `white` at most."""

    btf: BtfRows
    white: float

    @property
    def light_directions(self) -> Float64:
        """Unit vectors (light, 3)."""
        return self.btf.light_directions

    @property
    def view_directions(self) -> Float64:
        """Unit vectors (view, 3)."""
        return self.btf.view_directions

    @property
    def provenance(self) -> Provenance:
        """What it was made from."""
        return self.btf.provenance

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of light, view, y, x, channel."""
        return self.btf.shape

    def rows(self, rows: slice) -> Float32:
        """Texel rows under every light and view, (light, view, rows, x, channel)."""
        return self._limited(slice(None), self.btf.rows(rows))

    def row_spans(self) -> Iterator[slice]:
        """Spans of rows to read one after another."""
        return self.btf.row_spans()

    def blocks(self) -> Iterator[Block]:
        """Lights, rows, and what all views see of them, (light, view, row, x, channel); each sample once."""
        return ((lights, rows, self._limited(lights, block)) for lights, rows, block in self.btf.blocks())

    def _limited(self, lights: slice, block: Float32) -> Float32:
        return np.asarray(np.minimum(block, np.float32(self.white) / _cosines(self.btf, lights)))


def whitened(btf: BtfRows) -> Whitened:
    """White is the 99th percentile of what is measured, with the cosine; missing samples stay missing.

    One pass over data that need not fit in memory. A BTF without samples keeps its values.
    """
    bright = [(block * _cosines(btf, lights)).ravel()[::_EVERY] for lights, _, block in btf.blocks()]
    known = np.concatenate([values[np.isfinite(values)] for values in bright])
    return Whitened(btf, float(np.quantile(known, _SHARE)) if len(known) else np.inf)


def _cosines(btf: BtfRows, lights: slice) -> Float32:
    """Of the lights to the normal, (light, 1, 1, 1, 1); one under the horizon is all but level."""
    cosines = np.maximum(btf.light_directions[lights, 2], 1e-6)
    return cosines.astype(np.float32).reshape(-1, 1, 1, 1, 1)
