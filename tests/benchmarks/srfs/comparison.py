"""Representations of the same materials: error against truth, size and time, at measured directions and at others.

Four materials of spheres, in full under the arm's twelve lights and under a dome's 48 each, and four BTFs. Fits see
noisy samples (`material_samples`), errors are against the true ones; what the light does not reach counts nowhere.
Measured directions: all of them are fitted. Held-out: every third light of a sphere, or a random half of the pairs of
light and view of a BTF, is left out of the fit and asked for. The basis of `SRF, best basis` is the one that comes
nearest to the measured samples; for held-out directions that of least error in cross-validation over the others. Phong
is the single lobe of least squared error.

Figures are the worst of all data sets: squared error of the SRF with s . H, and of that with the best basis, over
Phong's (`mse_over_phong_sH`, `mse_over_phong_best`, `heldout_mse_over_phong_best`) or over the variance about each
texel's mean (`mse_over_variance`).
"""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from processing.products import ResidualBasis
from service.bench import Result
from tests.benchmarks.yardsticks.material_methods import (
    Fit,
    eight_methods,
    fitted,
    foretelling_basis,
    nearest_basis,
    of_each_size,
)
from tests.benchmarks.yardsticks.material_samples import (
    DEPTHS_M,
    SPHERES,
    Samples,
    arm_sphere,
    dome_sphere,
    far_btf,
)
from tests.benchmarks.yardsticks.picture_difference import mean_flip

SEED = 1  # methods, bases and planes were chosen on others
PICTURES = 4  # directions that FLIP looks at
FIGURES = {
    "mse_over_phong_sH": ("measured", "SRF, joint lobe", "over_phong"),
    "mse_over_phong_best": ("measured", "SRF, best basis", "over_phong"),
    "mse_over_variance": ("measured", "SRF, best basis", "over_variance"),
    "heldout_mse_over_phong_best": ("held-out", "SRF, best basis", "over_phong"),
}
Row = dict[str, object]


def run(*, quick: bool) -> Result:
    """All methods on all data sets; quick on fewer texels and directions, each sphere once, without the sizes."""
    _warm_up()
    materials = [make() for make in data_sets(quick=quick)]
    found = [row for material in materials for row in compare(material)]
    figures = {name: _values(found, *of) for name, of in FIGURES.items()}
    rows = [*found, *_medians(found), *(_spread(name, values) for name, values in figures.items())]
    of_sizes = [] if quick else sizes(materials)
    return Result({name: max(values) for name, values in figures.items()}, [*rows, *of_sizes])


def data_sets(*, quick: bool) -> list[Callable[[], Samples]]:
    """Each builds one; quick has glaze under the dome and grass too, which are the worst of all."""
    if quick:
        makers = zip([arm_sphere, dome_sphere] * 2, SPHERES, strict=True)
        spheres = [partial(make, sample, 20, SEED) for make, sample in makers]
        return [*spheres, *(partial(far_btf, sample, 24, 3, 5, SEED) for sample in DEPTHS_M)]
    spheres = [partial(make, sample, 64, SEED) for sample in SPHERES for make in (arm_sphere, dome_sphere)]
    return [*spheres, *(partial(far_btf, sample, 64, 4, 3, SEED) for sample in DEPTHS_M)]


def compare(material: Samples) -> list[Row]:
    """Rows of the eight methods, at measured and at held-out directions."""
    kept = material.only(~material.held)
    cases = (
        ("measured", material, material, nearest_basis(material)),
        ("held-out", kept, material.only(material.held), foretelling_basis(kept)),
    )
    rows = []
    for which, shown, asked, best in cases:
        found = {name: _errors(fit, name, shown, asked) for name, fit in eight_methods(best).items()}
        phong, variance = (float(found[name]["mse"]) for name in ("Phong", "mean per texel"))
        for name, errors in found.items():
            basis = {"basis": str(best)} if name == "SRF, best basis" else {}
            rows.append({
                "method": name, "parameter": f"material, {which} directions", "value": material.name,
                "directions": which, "error": errors["mse"] / phong, "unit": "squared errors of one lobe",
                "over_phong": errors["mse"] / phong, "over_variance": errors["mse"] / variance, **errors, **basis,
                "peer": not name.startswith("SRF"),
            })  # fmt: skip
    return rows


def _errors(fit: Fit, name: str, shown: Samples, asked: Samples) -> dict[str, float]:
    """Linear values over the largest true one for `mse` and `psnr_db`, over the mean square for `relative_mse`."""
    method = fitted(name, fit, shown)
    values = method.predict(asked)
    squares = float(np.nanmean((values - asked.true) ** 2))
    mse = squares / float(np.nanmax(asked.true)) ** 2
    pictures = np.linspace(0, len(values) - 1, PICTURES).astype(int)
    true, other = (some[pictures].reshape(PICTURES, *asked.shape, 3) for some in (asked.true, values))
    return {
        "mse": mse, "psnr_db": float(-10 * np.log10(mse)), "relative_mse": squares / float(np.nanmean(asked.true**2)),
        "flip": mean_flip(true, np.where(np.isnan(true), np.nan, other)), "bytes": method.size_bytes,
        "seconds": method.seconds,
    }  # fmt: skip


def sizes(materials: Sequence[Samples]) -> list[Row]:
    """Error over the values per texel, the median of the materials, the better basis of each size."""
    phong = eight_methods(ResidualBasis.HALF)["Phong"]
    lobes = [_squared_errors(phong, material) for material in materials]
    rows = []
    for family, by_size in of_each_size().items():
        for size, fits in by_size.items():
            least = [np.min([_squared_errors(fit, material) for fit in fits], axis=0) for material in materials]
            errors = np.median(np.divide(least, lobes), axis=0)
            rows += [{
                "method": family, "parameter": f"values per texel, {which} directions", "value": size,
                "error": float(error), "unit": "squared errors of one lobe", "peer": family != "SRF",
            } for which, error in zip(("measured", "held-out"), errors, strict=True)]  # fmt: skip
    return rows


def _squared_errors(fit: Fit, material: Samples) -> list[float]:
    """Means at measured and at held-out directions."""
    cases = ((material, material), (material.only(~material.held), material.only(material.held)))
    return [float(np.nanmean((fit(shown)[0](asked) - asked.true) ** 2)) for shown, asked in cases]


def _values(rows: Sequence[Row], which: str, method: str, key: str) -> list[float]:
    return [float(str(row[key])) for row in rows if (row["directions"], row["method"]) == (which, method)]


def _spread(name: str, values: Sequence[float]) -> Row:
    return {"figure": name, "median": float(np.median(values)), "worst": max(values), "least": min(values)}


def _medians(rows: Sequence[Row]) -> list[Row]:
    """Error over the time of the fits, the median of the materials."""
    return [
        {"method": method, "size": which, "unit": "squared errors of one lobe",
         "error": float(np.median(_values(rows, which, str(method), "over_phong"))),
         "flip": float(np.median(_values(rows, which, str(method), "flip"))),
         "seconds": float(np.median(_values(rows, which, str(method), "seconds"))),
         "peer": not str(method).startswith("SRF")}
        for which in ("measured", "held-out") for method in dict.fromkeys(row["method"] for row in rows)
    ]  # fmt: skip


def _warm_up() -> None:
    """Have all kernels compiled before anything is timed."""
    for tiny in (arm_sphere("stone", 8, 0), far_btf("brick", 8, 1, 20, 0)):
        for fit in eight_methods(ResidualBasis.BILINEAR).values():
            fit(tiny)
