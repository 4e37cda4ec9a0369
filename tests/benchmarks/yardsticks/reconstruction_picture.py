"""A picture of materials as eight methods draw them: `python -m tests.benchmarks.yardsticks.reconstruction_picture TO`.

A row for each material under one measured direction: truth first, then the methods.
"""

import sys
from functools import partial
from pathlib import Path

import numpy as np

from service.pictures import save_colour_panels
from tests.benchmarks.yardsticks.material_methods import eight_methods, nearest_basis
from tests.benchmarks.yardsticks.material_samples import DEPTHS_M, SPHERES, Array, Samples, dome_sphere, far_btf

SIZE, SEED = 48, 1


def main(to: Path) -> None:
    """Fit everything and write the picture."""
    spheres = [partial(dome_sphere, sample, SIZE, SEED) for sample in SPHERES]
    made = [make() for make in (*spheres, *(partial(far_btf, sample, SIZE, 4, 5, SEED) for sample in DEPTHS_M))]
    panels = [panel for material in made for panel in reconstructions(material).items()]
    save_colour_panels(to, panels, len(panels) // len(made))


def reconstructions(material: Samples) -> dict[str, Array]:
    """Truth and every method (y, x, 3) in the measured direction of the strongest contrast, by name."""
    contrast = np.nanstd(material.true, axis=(1, 2)) / np.nanmean(material.true, axis=(1, 2))
    asked = material.only(np.arange(len(contrast)) == np.argsort(contrast)[3 * len(contrast) // 4])
    methods = eight_methods(nearest_basis(material))
    drawn = {name: fit(material)[0](asked)[0] for name, fit in methods.items()}
    shown = {f"{material.name}: truth".replace("\n", ", "): asked.true[0], **drawn}
    bright = np.nanpercentile(asked.true, 98)  # so that materials are shown alike
    return {name: np.float32(values / bright).reshape(*material.shape, 3) for name, values in shown.items()}


if __name__ == "__main__":
    main(Path(sys.argv[1]))
