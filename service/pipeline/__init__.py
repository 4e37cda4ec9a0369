"""From a session to its products: the one way of a frame after it is durable.

Every product is a folder under `products/` that names the frames, the calibration and the parameters it came from.
A product whose inputs have not changed is not made again.
"""

from collections.abc import Sequence
from pathlib import Path

from rig.errors import StateError
from rig.sessions import BtfPlan, CalibratePlan, EnvironmentPlan, LampsPlan, MdfPlan, SensorPlan, Session, SrfPlan
from service.pipeline.btf import make_btf
from service.pipeline.calibration import make_calibration
from service.pipeline.calibrations import load_calibrations
from service.pipeline.environment import make_environment
from service.pipeline.inputs import Progress
from service.pipeline.lamps import make_lamps
from service.pipeline.mdf import make_mdf
from service.pipeline.sensor import make_sensors
from service.pipeline.srf import make_srf

DEFAULT_RANK = 4  # of the factored BTF: the paper's number of eigenmaps


def process(
    session: Session, calibrated: Sequence[Path], progress: Progress, *, rank: int = DEFAULT_RANK
) -> list[Path]:
    """Make every product of a session; returns their folders.

    `calibrated` are folders of processed sessions that measured the rig; `btf` and `mdf` need a `calibrate` session,
    and so does `lamps`; where a `lamps` session is among them, `srf` and `btf` take its directions and distances.
    Raises StateError where steps are still to be taken: a product of some of them would look like one of all.
    Raises MissingFrameError, ImageError, CalibrationError; products that exist stay as they were.
    """
    if (left := len(session.remaining())) > 0:
        of_all = f"{left} of {len(session.steps)} steps"
        raise StateError(f"{session.folder}: {of_all} are still to be taken; `rig resume {session.folder}` takes them.")
    calibrations = load_calibrations(calibrated)
    match session.plan:
        case CalibratePlan():
            return [make_calibration(session, calibrations, progress)]
        case SrfPlan():
            return make_srf(session, calibrations, progress)
        case BtfPlan():
            return make_btf(session, calibrations, progress, rank)
        case MdfPlan():
            return [make_mdf(session, calibrations, progress)]
        case SensorPlan():
            return make_sensors(session, progress)
        case LampsPlan():
            return [make_lamps(session, calibrations, progress)]
        case EnvironmentPlan():
            return [make_environment(session, progress)]
