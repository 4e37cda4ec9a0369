"""Reflectance maps and the SRF of a sphere from an `srf` session."""

from math import radians
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from processing.materials.limb import SphereImage, find_sphere
from processing.materials.measurements import sphere_measurements
from processing.materials.reflectance_map import SpherePhotographs, WhiteCard, card_irradiance, reflectance_maps
from processing.materials.srf import SrfFit, fit_phong, fit_srf
from processing.products import ReflectanceMaps
from processing.radiometry.mosaic import demosaic
from rig.sessions import Session, SrfPlan
from service.pipeline.calibrations import Calibrations
from service.pipeline.inputs import Progress, fingerprint, is_current, provenance
from service.pipeline.stacks import MergedStack, Stack, lamp_distance_m, light_direction, merge, stacks

MAP_SIZE = 256
# The rig frame seen by a camera at azimuth 0 that looks along -X: x right, y down, z away from it.
MAP_FROM_RIG = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])


def make_srf(session: Session, calibrations: Calibrations, progress: Progress) -> list[Path]:
    """Reflectance maps, and the SRF fitted to them: one joint lobe, the shortest residual per texel."""
    folders = [session.products / "reflectance_maps", session.products / "srf"]
    inputs = fingerprint(session.frames(), {"size": MAP_SIZE, "calibrations": calibrations.digest()})
    if all(is_current(folder, inputs) for folder in folders):
        return folders
    maps, _ = measure_maps(session, calibrations, progress, inputs)
    maps.save(folders[0])
    fit_material(maps).srf.save(folders[1])
    return folders


def measure_maps(
    session: Session, calibrations: Calibrations, progress: Progress, inputs: dict[str, object]
) -> tuple[ReflectanceMaps, SphereImage]:
    """Reflectance maps of all lights, and where the sphere was found."""
    assert isinstance(session.plan, SrfPlan)
    gathered = stacks(session.frames())
    merged = [merge(stack, calibrations) for stack in progress.track(gathered, "merging exposures")]
    photographs = _photographs(session, calibrations, gathered, merged)
    sphere = find_sphere(np.stack([_luminance(one) for one in merged]))
    card = session.plan.card
    white = WhiteCard(card.y_mm / 1e3, card.z_mm / 1e3, card.width_mm / 1e3, card.height_mm / 1e3, card.reflectance)
    irradiance = card_irradiance(photographs, sphere, white)
    return reflectance_maps(photographs, sphere, irradiance, MAP_SIZE, provenance(session, inputs)), sphere


def fit_material(maps: ReflectanceMaps) -> SrfFit:
    """The joint Blinn-Phong lobe and the residual over it."""
    return fit_srf(maps, fit_phong(sphere_measurements(maps)).phong)


def _photographs(
    session: Session, calibrations: Calibrations, gathered: list[Stack], merged: list[MergedStack]
) -> SpherePhotographs:
    assert isinstance(session.plan, SrfPlan)
    directions = np.stack([light_direction(session.config, stack.step, calibrations) for stack in gathered])
    camera = session.config.cameras[session.plan.camera]
    return SpherePhotographs(
        np.stack([one.radiance.value for one in merged]),
        np.stack([one.radiance.variance for one in merged]),
        merged[0].cfa,
        directions @ _map_from_rig(camera.elevation_deg).T,
        np.array([lamp_distance_m(session.config, stack.step, calibrations) for stack in gathered]),
        camera.distance_mm / 1e3,
        session.plan.sphere_radius_mm / 1e3,
    )


def _map_from_rig(elevation_deg: float) -> NDArray[np.float64]:
    """Rig directions in the frame of a camera at azimuth 0 and this elevation."""
    c, s = np.cos(radians(elevation_deg)), np.sin(radians(elevation_deg))
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    return np.asarray(tilt @ MAP_FROM_RIG, np.float64)


def _luminance(merged: MergedStack) -> NDArray[np.float32]:
    colour, _ = demosaic(merged.radiance.value, merged.radiance.variance, merged.cfa)
    return np.asarray(colour.mean(axis=-1), np.float32)
