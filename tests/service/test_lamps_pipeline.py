"""A lamps session on the simulated rig, its models, and who uses them."""

from dataclasses import replace
from math import radians

import numpy as np
import pytest

from processing.cameras.calibration import write_cameras
from processing.errors import CalibrationError
from processing.lamps.model import LampModel, LampStatus, read_lamps
from rig.config import load_config
from rig.sessions import Session, Step, parse_plan
from service.capture import capture
from service.console import ConsoleProgress
from service.pipeline import process
from service.pipeline.calibrations import CALIBRATION, CAMERAS, LAMP_MODELS, LAMPS, Calibrations, load_calibrations
from service.pipeline.stacks import lamp_distance_m, light_direction
from service.simulation import Simulation
from tests.reference.lamp_rig import LampRig, angle_deg
from tests.rig.sessions.fake_rig import config

PLAN = {
    "kind": "lamps", "lamps": ["lamp2", "lamp5", "led"], "light_arc_deg": [60, -120], "arm_deg": [-40, 40],
    "cameras": ["cam1", "cam4"], "mirror": {"radius_mm": 20, "exposures_s": [0.004]},
    "white": {"reflectance": 0.9, "exposures_s": [0.03]},
}  # fmt: skip


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """Folders of a processed lamps session and of cameras that are known to be true."""
    folder = tmp_path_factory.mktemp("lamps")
    known = folder / "board" / "products" / CALIBRATION
    known.mkdir(parents=True)
    write_cameras(LampRig.of(1).cameras, known / CAMERAS)
    with Simulation(folder / "simulation", seed=1) as simulation, ConsoleProgress() as progress:
        plan, rig = parse_plan(PLAN), load_config(simulation.rig_toml)
        capture(plan, rig, folder / "lamps", operator=simulation.mount, on_event=lambda event: None)
        with Session.open(folder / "lamps") as session:
            products = process(session, [folder / "board"], progress)
            made = (products[0] / "product.json").stat().st_mtime_ns
            assert process(session, [folder / "board"], progress) == products
            assert (products[0] / "product.json").stat().st_mtime_ns == made  # nothing changed: not made again
    return folder / "lamps", folder / "board"


def test_models_are_right_and_drawn(measured):
    rig, product = LampRig.of(1), measured[0] / "products" / LAMPS
    models = read_lamps(product / LAMP_MODELS)
    assert list(models) == PLAN["lamps"]
    assert (product / "lamps.png").stat().st_size > 10_000
    for name, model in models.items():
        assert model.status == (LampStatus.DISTANCE_ASSUMED if name == "led" else LampStatus.MEASURED)
        assert angle_deg(model.position_m, rig.position(name)) < 0.2
    assert np.isnan(models["led"].intensity_e_s).all()  # level with the plate
    # Sensors differ from what their files state by a percent or two, which intensities have in common.
    np.testing.assert_allclose(models["lamp5"].intensity_e_s, np.exp(rig.log_intensity("lamp5")), rtol=0.06)


def test_both_sessions_together_are_the_calibration(measured):
    calibrations = load_calibrations(measured)
    assert set(calibrations.lamps) == set(PLAN["lamps"])
    assert {"cam1", "cam4"} <= set(calibrations.cameras)
    alone = load_calibrations(measured[1:])
    assert alone.lamps == {}
    assert alone.digest() != calibrations.digest()


def test_a_session_without_results_is_named(tmp_path):
    with pytest.raises(CalibrationError, match="not calibrated yet"):
        load_calibrations([tmp_path])


LAMP = LampModel("lamp0", "light_arc", np.array([0.7, 0.1, 0.5]), 1e-6 * np.eye(3))
STEP = Step("step", {"turntable": radians(30), "light_arc": radians(70), "arm": 0.0}, ("lamp0",), 0.1, ("cam0",))


def test_measured_lamps_are_used_and_others_are_nominal():
    """Towards the lamp in the sample frame: the arc's angle less the turntable's."""
    known = Calibrations(lamps={"lamp0": LAMP})
    np.testing.assert_allclose(light_direction(config(), STEP, known), LAMP.direction(radians(40)))
    assert lamp_distance_m(config(), STEP, known) == pytest.approx(LAMP.distance_m)
    nominal = light_direction(config(), STEP, Calibrations())
    np.testing.assert_allclose(np.degrees(np.arctan2(nominal[1], nominal[0])), 40)
    assert np.degrees(np.arcsin(nominal[2])) == pytest.approx(30)
    unmeasured = Calibrations(lamps={"lamp0": replace(LAMP, status=LampStatus.NOT_MEASURED)})
    np.testing.assert_array_equal(light_direction(config(), STEP, unmeasured), nominal)
    assert lamp_distance_m(config(), STEP, unmeasured) == 0.9
