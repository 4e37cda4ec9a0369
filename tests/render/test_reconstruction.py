"""The sphere drawn from an SRF shows what the reflectance maps say that the SRF was fitted to."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from processing.materials.srf import fit_srf
from processing.products import ReflectanceMaps, ResidualBasis, sphere_normals
from render.camera import look_at
from render.reference import ReferenceRenderer
from render.scene import Scene, light
from render.shapes import MAP_FROM_RIG, captured_sphere
from simulators.sphere_truth import reflectance_maps

SIZE, FAR_M = 32, 60.0  # a thousand radii: the maps are of distant light and view
ANGLES = [(azimuth, elevation) for azimuth in (-60, -20, 20, 60) for elevation in (-20, 15, 50)]
LIGHTS = [light(np.radians(azimuth), np.radians(elevation)) for azimuth, elevation in ANGLES]


@pytest.fixture(scope="module")
def maps() -> ReflectanceMaps:
    """The simulated stone under twelve lights, from where the capture's camera stands."""
    directions = np.stack([each.direction for each in LIGHTS])
    seen = reflectance_maps("sphere", 5, FAR_M * directions, np.array([FAR_M, 0.0, 0.0]), SIZE)
    away = np.full(len(LIGHTS), np.inf)
    return ReflectanceMaps(seen, np.full_like(seen, 1e-6), directions @ MAP_FROM_RIG.T, away, np.inf)


@pytest.mark.parametrize("basis", [ResidualBasis.HALF, ResidualBasis.HALF_LIGHT])
@pytest.mark.parametrize("renderer", ["gl", "reference"])
def test_drawn_sphere_is_the_captured_one(request, maps, basis, renderer):
    """At the maps' own points and lights the picture errs as the fit does; mirrored or upside down it would not."""
    drawing = request.getfixturevalue("gl") if renderer == "gl" else ReferenceRenderer()
    fit = fit_srf(maps, basis=basis)
    camera = look_at((1000.0, 0.0, 0.0), (0.0, 0.0, 0.0), (300, 300), field_of_view_rad=2.2e-3)
    mesh = captured_sphere(shape=(96, 192))
    normals = sphere_normals(SIZE)
    image = camera.in_camera((normals @ MAP_FROM_RIG).reshape(-1, 3)) @ camera.matrix.T
    row_column = (image[:, 1::-1] / image[:, 2:]).T
    upright, upside_down, sideways = [], [], []
    for number in (1, 5, 9):
        picture = drawing.draw(Scene.of(mesh, fit.srf, camera, (LIGHTS[number],))).radiance
        seen = np.stack([map_coordinates(picture[..., c], row_column, order=1) for c in range(3)], axis=-1)
        drawn, true = seen.reshape(SIZE, SIZE, 3), maps.reflectance_cos[number]
        lit = (maps.lights()[number] * normals).sum(axis=2) > 0.15  # not where a texel is half in the shade
        for errors, other in ((upright, drawn), (upside_down, drawn[::-1]), (sideways, drawn[:, ::-1])):
            errors.append((other - true)[lit])
    error, *wrong = (np.sqrt(np.mean(np.concatenate(each) ** 2)) for each in (upright, upside_down, sideways))
    # The fit's own error is a mean over all twelve lights: three of them may lie a third above it.
    assert error < 1.35 * np.sqrt(fit.mse_srf) * fit.peak
    assert min(wrong) > 2.0 * error
