"""Pictures under every light, normals, the surface and its SRF of a body of any shape, from an `srf` session."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from processing.materials.light_pictures import light_stack
from processing.materials.measurements import stack_measurements, view_frames
from processing.materials.photometric_stereo import find_normals
from processing.materials.sight import sight_of_body
from processing.materials.srf import fit_srf_to_stack
from processing.materials.surface import integrate, triangulate
from processing.products import LightStack, NormalMap
from render.mesh import Mesh
from render.mesh_file import save_mesh
from rig.sessions import Session, SrfPlan
from service.pipeline.calibrations import Calibrations
from service.pipeline.inputs import Progress, fingerprint, is_current, provenance
from service.pipeline.lit_body import read_body, white_card
from service.pipeline.srf_model import model_for
from service.viewing import SKIN_MESH

PRODUCTS = ("light_stack", "normals", "srf")


def make_shape(session: Session, calibrations: Calibrations, progress: Progress) -> list[Path]:
    """Pictures of one light each, normals by photometric stereo, the SRF on them, and beside it the surface.

    Raises CalibrationError where the camera was not calibrated: without it nothing tells the scale.
    """
    folders = [session.products / name for name in PRODUCTS]
    inputs = fingerprint(session.frames(), {"calibrations": calibrations.digest()})
    if all(is_current(folder, inputs) for folder in folders):
        return folders
    stack = measure_stack(session, calibrations, progress, inputs)
    normals = find_normals(stack)
    stack.save(folders[0])
    normals.save(folders[1])
    folders[2].mkdir(parents=True, exist_ok=True)
    save_mesh(folders[2] / SKIN_MESH, surface_mesh(normals, integrate(normals)))
    measured = stack_measurements(stack, normals, np.flatnonzero(normals.measured))
    lobe, basis = model_for(measured, stack.light_directions, progress)
    fit_srf_to_stack(stack, normals, lobe, basis).srf.save(folders[2])
    return folders


def measure_stack(
    session: Session, calibrations: Calibrations, progress: Progress, inputs: dict[str, object]
) -> LightStack:
    """Pictures of the body under every light, about the middle of the rig."""
    assert isinstance(session.plan, SrfPlan)
    camera = calibrations.camera(session.plan.camera)
    body = read_body(session, calibrations, progress)
    sight = sight_of_body(camera, np.zeros(3))
    photographs = body.photographs(sight.centre_m, sight.rig_from_view, sight.radius_m)
    return light_stack(photographs, sight, white_card(session.plan), provenance(session, inputs))


def surface_mesh(normals: NormalMap, depth_m: NDArray[np.float64]) -> Mesh:
    """The surface in the view frame, with the measured normals and the tangent frames that the SRF is fitted in."""
    positions, triangles, uv = triangulate(depth_m, normals.pixel_m)
    rows, columns = depth_m.shape
    row, column = (np.rint(uv[:, ::-1] * (rows, columns) - 0.5)).astype(np.intp).T
    normal = normals.normals[row, column].astype(np.float64)
    tangents = np.column_stack([view_frames(normal)[:, 0], np.ones(len(normal))])
    return Mesh(positions, normal, tangents, uv, triangles)
