"""The light of a place from the photographs of an `environment` session."""

from dataclasses import replace
from pathlib import Path

from processing.environment.brackets import Bracket
from render.picture import save_image
from rig.sessions import EnvironmentPlan, FrameRecord, Session
from service.environment import PICTURE, PlaceOptions, about_light, photographed
from service.environment_pictures import panorama_picture
from service.pipeline.inputs import Progress, fingerprint, is_current, provenance

ENVIRONMENT = "environment"


def make_environment(session: Session, progress: Progress) -> Path:
    """The cubemap of light that front and back photographs tell, and pictures of it and of what was found in them.

    Raises ImageError where the photographs cannot be merged or do not fit together.
    """
    plan = session.plan
    assert isinstance(plan, EnvironmentPlan)
    folder, records = session.products / ENVIRONMENT, session.frames()
    field_deg = session.config.cameras[plan.camera].field_deg
    assert field_deg is not None, "the planner takes cameras in the hand alone, and these have one"
    inputs = fingerprint(records, {"field_deg": field_deg, "texels": plan.texels, "azimuth_deg": plan.azimuth_deg})
    if is_current(folder, inputs) and (folder / PICTURE).is_file():
        return folder
    folder.mkdir(parents=True, exist_ok=True)
    options = PlaceOptions(field_deg=field_deg, size=plan.texels, azimuth_deg=plan.azimuth_deg)
    front, back = (_bracket(records, facing) for facing in ("front", "back"))
    captured, told = photographed(front, back, options, folder)
    for line in (*told, *about_light(captured.environment)):
        progress.note(line)
    save_image(folder / PICTURE, panorama_picture(captured.environment))
    replace(captured.environment, provenance=provenance(session, inputs)).save(folder)
    return folder


def _bracket(records: list[FrameRecord], facing: str) -> Bracket:
    """One direction's files; their exposure times are those of the files themselves."""
    return Bracket(tuple(record.path for record in records if (record.step.mount or {}).get("facing") == facing))
