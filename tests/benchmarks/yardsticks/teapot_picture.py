"""Fig. 8 of Iwasaki et al.: a teapot's shadow by fields of 64 to 8 spheres, beside direct summation.

`python -m tests.benchmarks.yardsticks.teapot_picture TO` writes a row with spheres at growing distances, and one with
equally distant ones as in the paper.
"""

import sys
from pathlib import Path
from typing import Literal

import numpy as np

from processing.lighting.directions import sample_directions
from processing.lighting.precomputation import TOLERANCE
from processing.lighting.shells import ShellPlan
from render.relit_view import open_relit_view
from service.pictures import save_colour_panels
from tests.benchmarks.yardsticks.relit_furniture import windows
from tests.benchmarks.yardsticks.teapot_scene import WHITE, teapot_scene

SIZE = 480, 360
RESOLUTIONS = 64, 32, 16, 8
SPACINGS: tuple[Literal["growing", "uniform"], ...] = ("growing", "uniform")


def main(to: Path, detail: float = 0.7, floor: int = 100) -> None:
    """Relight it and write the picture."""
    scene, sampled, paint = teapot_scene(detail, floor), sample_directions(), (WHITE, WHITE)
    vertices = np.arange(scene.first[-1])
    truth = scene.direct(vertices, sampled, windows(), paint)
    cuts = scene.cuts(vertices, sampled, TOLERANCE)
    view, camera = open_relit_view(scene.meshes), scene.camera(SIZE)
    panels = []
    for spacing in SPACINGS:
        found = [("direct summation", truth)]
        for resolution in RESOLUTIONS:
            bodies = scene.relit(cuts, scene.field(vertices, sampled, ShellPlan(resolution, spacing)))
            relit = scene.relighting(bodies, sampled, windows(), paint)
            found.append((f"{resolution} spheres, {spacing}", relit.frame().radiance))
        panels += [
            (name, view.draw(camera, scene.poses, radiance.astype(np.float32)).radiance) for name, radiance in found
        ]
    view.release()
    save_colour_panels(to, panels, 1 + len(RESOLUTIONS))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
