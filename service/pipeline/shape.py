"""Pictures under every light, normals and the surface of a body of any shape, from an `srf` session."""

from pathlib import Path

import numpy as np

from processing.materials.light_pictures import light_stack
from processing.materials.sight import sight_of_body
from rig.sessions import Session, SrfPlan
from service.pipeline.calibrations import Calibrations
from service.pipeline.inputs import Progress, fingerprint, is_current, provenance
from service.pipeline.lit_body import read_body, white_card


def make_shape(session: Session, calibrations: Calibrations, progress: Progress) -> list[Path]:
    """Pictures of one light each.

    Raises CalibrationError where the camera was not calibrated: without it nothing tells the scale.
    """
    assert isinstance(session.plan, SrfPlan)
    camera = calibrations.camera(session.plan.camera)
    folders = [session.products / "light_stack"]
    inputs = fingerprint(session.frames(), {"calibrations": calibrations.digest()})
    if all(is_current(folder, inputs) for folder in folders):
        return folders
    body = read_body(session, calibrations, progress)
    sight = sight_of_body(camera, np.zeros(3))
    photographs = body.photographs(sight.centre_m, sight.rig_from_view, sight.radius_m)
    stack = light_stack(photographs, sight, white_card(session.plan), provenance(session, inputs))
    stack.save(folders[0])
    return folders
