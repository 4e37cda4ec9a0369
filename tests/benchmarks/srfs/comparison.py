"""Representations of the same materials: error against truth, size and time, at measured directions and at others.

Errors are mean squares of linear values over the largest true one, so that they lie in [0, 1]. Measured directions:
all of them are fitted. Held-out: every third is left out of the fit and asked for.
"""

import numpy as np

from service.bench import Result
from simulators.layout import direction
from tests.benchmarks.yardsticks.material_methods import fit_all
from tests.benchmarks.yardsticks.material_samples import Samples, arm_m, dome_m, sphere_samples

SEED = 1


def run(*, quick: bool) -> Result:
    """Every method on every material; quick on maps of 48 x 48."""
    size = 48 if quick else 128
    front = 1.1 * direction(0.0, 0.0)
    above = 1.0 * direction(0.0, np.radians(88.0))
    materials = [
        sphere_samples("stone, arm", arm_m(), front, size, SEED),
        sphere_samples("stone, dome", dome_m((20, 40, 60, 80), 12), above, size, SEED),
    ]
    rows = [row for material in materials for row in compare(material)]
    return Result({}, rows)


def compare(material: Samples) -> list[dict[str, object]]:
    """Rows of all methods, at measured and at held-out directions."""
    every = np.arange(len(material.true))
    held = every[1::3]
    kept = np.setdiff1d(every, held)
    peak = float(np.nanmax(material.true))
    rows = []
    for which, fitted_to, asked_for in (("measured", every, every), ("held-out", kept, held)):
        asked = material.only(asked_for)
        for fitted in fit_all(material.only(fitted_to)):
            error = (fitted.predict(asked) - asked.true) / peak
            mse = float(np.nanmean(error**2))
            rows.append({"method": fitted.method, "parameter": f"material, {which} directions",
                         "value": material.name, "error": mse, "seconds": fitted.seconds, "bytes": fitted.bytes,
                         "unit": "linear values over the largest, squared"})  # fmt: skip
    return rows
