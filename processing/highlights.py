"""What is white in a BTF, as in photographs of one exposure.

A few glints are so bright that the terms of least squared error go to them, and all else loses its colour: with twelve
terms a glazed brick and its mortar become one. No picture shows a glint brighter than its white.
"""

import numpy as np

from processing.svd import BtfRows

_SHARE = 0.99  # of the samples that white is not brighter than
_EVERY = 31  # sample is asked what is bright: prime, so that channels, texels and views take their turns


def white_of(btf: BtfRows) -> float:
    """The 99th percentile of reflectance times the light's cosine, 1/sr; missing samples tell nothing of it.

    One pass over data that need not fit in memory. Infinite where no sample is known.
    """
    bright = []
    for lights, _, block in btf.blocks():
        cosines = btf.light_directions[lights, 2].astype(np.float32).reshape(-1, 1, 1, 1, 1)
        values = (block * cosines).ravel()[::_EVERY]
        bright.append(values[np.isfinite(values)])
    known = np.concatenate(bright)
    return float(np.quantile(known, _SHARE)) if len(known) else np.inf
