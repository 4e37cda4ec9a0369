"""Reflectance maps and the SRF of a sphere from an `srf` session; `shape` has bodies that are no sphere."""

from math import radians
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from processing.materials.limb import SphereImage, find_sphere
from processing.materials.measurements import sphere_measurements
from processing.materials.photographs import BodyPhotographs
from processing.materials.reflectance_map import reflectance_maps
from processing.materials.sight import CircleSight, Sight, sight_of_sphere
from processing.materials.srf import SrfFit, fit_srf
from processing.materials.white_card import card_irradiance
from processing.products import ReflectanceMaps
from processing.radiometry.mosaic import demosaic
from rig.config import CameraConfig
from rig.sessions import Session, SrfPlan
from service.pipeline.calibrations import Calibrations
from service.pipeline.inputs import Progress, fingerprint, is_current, provenance
from service.pipeline.lit_body import LitBody, read_body, white_card
from service.pipeline.shape import make_shape
from service.pipeline.srf_model import model_for
from service.pipeline.stacks import MergedStack

MAP_SIZE = 256
# The rig frame seen by a camera at azimuth 0 that looks along -X: x right, y down, z away from it.
MAP_FROM_RIG = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])


def make_srf(session: Session, calibrations: Calibrations, progress: Progress) -> list[Path]:
    """Reflectance maps of a sphere, and the SRF fitted to them; of another shape what `make_shape` makes."""
    assert isinstance(session.plan, SrfPlan)
    if session.plan.sphere_radius_mm is None:
        return make_shape(session, calibrations, progress)
    folders = [session.products / "reflectance_maps", session.products / "srf"]
    inputs = fingerprint(session.frames(), {"size": MAP_SIZE, "calibrations": calibrations.digest()})
    if all(is_current(folder, inputs) for folder in folders):
        return folders
    maps, _ = measure_maps(session, calibrations, progress, inputs)
    maps.save(folders[0])
    fit_material(maps, progress).srf.save(folders[1])
    return folders


def measure_maps(
    session: Session, calibrations: Calibrations, progress: Progress, inputs: dict[str, object]
) -> tuple[ReflectanceMaps, SphereImage]:
    """Reflectance maps of all lights, and where the sphere was found."""
    assert isinstance(session.plan, SrfPlan)
    body = read_body(session, calibrations, progress)
    sphere = find_sphere(np.stack([_luminance(one) for one in body.merged]))
    photographs, sight = _seen(session, calibrations, body, sphere)
    irradiance = card_irradiance(photographs, sight, white_card(session.plan))
    return reflectance_maps(photographs, sight, irradiance, MAP_SIZE, provenance(session, inputs)), sphere


def fit_material(maps: ReflectanceMaps, progress: Progress) -> SrfFit:
    """Lobe and residual, of the kind that the lights can tell."""
    return fit_srf(maps, *model_for(sphere_measurements(maps), maps.light_directions, progress))


def _seen(
    session: Session, calibrations: Calibrations, body: LitBody, sphere: SphereImage
) -> tuple[BodyPhotographs, Sight]:
    """By the calibrated camera with its distortion, else by the circle and where rig.toml has the camera."""
    assert isinstance(session.plan, SrfPlan)
    assert session.plan.sphere_radius_mm is not None
    radius_m, name = session.plan.sphere_radius_mm / 1e3, session.plan.camera
    if name in calibrations.cameras:
        sight = sight_of_sphere(calibrations.cameras[name], sphere, radius_m)
        return body.photographs(sight.centre_m, sight.rig_from_view, radius_m), sight
    camera = session.config.cameras[name]
    photographs = body.photographs(np.zeros(3), map_from_rig(camera).T, radius_m)
    return photographs, CircleSight(sphere, camera.distance_mm / 1e3 / radius_m)


def map_from_rig(camera: CameraConfig) -> NDArray[np.float64]:
    """Rig directions in the frame of a camera at azimuth 0 and its elevation."""
    c, s = np.cos(radians(camera.elevation_deg)), np.sin(radians(camera.elevation_deg))
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    return np.asarray(tilt @ MAP_FROM_RIG, np.float64)


def _luminance(merged: MergedStack) -> NDArray[np.float32]:
    colour, _ = demosaic(merged.radiance.value, merged.radiance.variance, merged.cfa)
    return np.asarray(colour.mean(axis=-1), np.float32)
