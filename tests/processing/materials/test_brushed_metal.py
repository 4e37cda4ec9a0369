"""The anisotropic lobe on metal that is another model's: the simulators' facets, seen under lights of a dome."""

import numpy as np

from processing.materials.anisotropic import fit_anisotropic_beside_residual
from processing.materials.joint_lobe import fit_phong_beside_residual
from processing.materials.measurements import sphere_measurements
from processing.materials.sample_geometry import SampleGeometry
from processing.materials.texel_fits import Model, Samples, fit_texels
from processing.products import AnisotropicPhong, ReflectanceMaps, ResidualBasis, sphere_normals, tangent_frames
from simulators.layout import direction
from simulators.samples.spheres import SPHERES
from simulators.sphere_truth import camera_axes, reflectance_maps

SIZE, SEED, RADIUS_M = 16, 2, 0.05


def measured(eye, lights):
    """The metal as a camera at the eye sees it, without noise."""
    maps, distance_m = reflectance_maps("sphere-brushed", SEED, lights, eye, SIZE), np.linalg.norm(lights, axis=1)
    return sphere_measurements(
        ReflectanceMaps(
            maps,
            np.full(maps.shape, 1e-6, np.float32),
            lights / distance_m[:, None] @ camera_axes(eye),
            distance_m / RADIUS_M,
            float(np.linalg.norm(eye)) / RADIUS_M,
        )
    )


def turn_across(eye):
    """Angle from t toward b of the way across the grain, the mean over the map."""
    in_view = sphere_normals(SIZE).reshape(-1, 3)
    _, material = SPHERES["sphere-brushed"](in_view @ camera_axes(eye).T, SEED)
    along = np.einsum("nij,nj->ni", tangent_frames(in_view), material.grain.along @ camera_axes(eye))
    return np.angle(-np.sum((along[:, 0] + 1j * along[:, 1]) ** 2)) / 2


def held_out_error(fitted_to, asked, lobe):
    """Mean square at directions that neither the lobe nor the residuals have seen."""
    samples = Samples(fitted_to.texels, np.arange(fitted_to.value.shape[1]), fitted_to)
    fits = fit_texels(samples, Model(lobe, ResidualBasis.HALF, 0.03))
    functions = SampleGeometry.of(asked, ResidualBasis.HALF).basis
    residual = np.einsum("tck,tkd->dtc", np.nan_to_num(fits.residual.coefficients), functions)
    return np.mean((asked.delta(lobe) - residual)[asked.valid] ** 2)


def test_brushed_metal_is_found_to_be_drawn_out_across_its_grain():
    eye = 1.0 * direction(np.radians(35.0), np.radians(88.0))
    places = [(elevation, azimuth) for elevation in (20, 50, 80) for azimuth in range(15, 360, 30)]
    lights = np.stack([0.9 * direction(np.radians(azimuth), np.radians(elevation)) for elevation, azimuth in places])
    metal, held = measured(eye, lights), np.arange(len(lights)) % 3 == 1
    kept, asked = (metal.directions(np.flatnonzero(chosen)) for chosen in (~held, held))
    fit, round_lobe = fit_anisotropic_beside_residual(kept).lobe, fit_phong_beside_residual(kept).lobe.phong
    assert isinstance(fit, AnisotropicPhong)
    wide = fit.turn_rad + np.pi / 2 * (fit.exponents[0] > fit.exponents[1])  # the way of the lower exponent
    off_deg = np.degrees(np.angle(np.exp(2j * (wide - turn_across(eye)))) / 2)
    assert abs(off_deg) < 3
    assert max(fit.exponents) > 4 * min(fit.exponents)
    assert held_out_error(kept, asked, fit) < 0.4 * held_out_error(kept, asked, round_lobe)
