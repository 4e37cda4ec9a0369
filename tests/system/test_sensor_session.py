"""A sensor session on the simulated rig: what is measured is the truth, and the other pipelines use it."""

import json
import shutil
from dataclasses import fields, replace

import numpy as np
import pytest

from processing.errors import CalibrationError
from processing.radiometry.hdr import PixelStatus
from processing.radiometry.sensor_calibration import SensorCalibration
from rig import load_config, open_rig
from rig.sessions import Runner, Session, parse_plan
from service.console import ConsoleProgress
from service.pipeline import process
from service.pipeline.calibrations import Calibrations, load_calibrations
from service.pipeline.stacks import merge, stacks

SENSOR = {
    "kind": "sensor", "cameras": ["cam4"], "dark_exposures_s": [2.0, 0.5, 0.001], "repeats": 3,
    "flat_exposures_s": [0.5, 0.4, 0.33, 0.25, 0.2, 0.15, 0.1, 0.04, 0.01],
}  # fmt: skip
BTF = {
    "kind": "btf", "turntable_deg": [0], "light_azimuth_deg": [60], "lamps": ["lamp6"], "sample": "white",
    "cameras": ["cam4"], "exposures_s": [0.02, 0.16], "texels": 16,
}  # fmt: skip


@pytest.fixture(scope="module")
def captured(shared_simulated_rig, tmp_path_factory):
    """Folders of a finished sensor session and of a bracket of a white plate, and the rig."""
    rig = shared_simulated_rig
    before = rig.control("status")["sample"]
    folder = tmp_path_factory.mktemp("sessions")
    for name, plan in (("sensor", SENSOR), ("white", BTF)):
        with Session.create(folder / name, parse_plan(plan), load_config(rig.toml)) as session:
            with open_rig(session.config) as devices:
                assert Runner(session, devices, lambda mount: rig.control("mount", **mount)).run().state == "finished"
            assert not [event for event in session.events() if event.kind in ("warning", "retake")]
    rig.control("mount", sample=before)
    return folder, rig


@pytest.fixture(scope="module")
def product(captured):
    folder, _ = captured
    with Session.open(folder / "sensor") as session:
        (made,) = process(session, [], ConsoleProgress())
        assert process(session, [], ConsoleProgress()) == [made]  # and not again
    return made


def test_the_product_carries_the_serial_number_and_the_truth(captured, product):
    assert product.name == "VC-0004"
    assert (product / "picture.png").stat().st_size > 20_000
    found = SensorCalibration.load(product)
    true = captured[1].control("truth", what="sensor", camera="cam4")
    assert (found.serial, found.iso) == ("VC-0004", 100)
    for name in ("gain_e_per_dn", "read_noise_e"):
        figure = found.measurement.figures[name]
        assert abs(figure.value - true["sensor"][name]) < 4 * figure.sigma
        assert figure.value == pytest.approx(true["sensor"][name], rel=0.02)
    flat = nominal(np.load(true["flat_path"]))
    sound = ~found.correction.hot
    error = (found.correction.flat - flat)[sound] / np.sqrt(found.correction.flat_variance[sound])
    assert np.sqrt(np.mean(error**2)) == pytest.approx(1, abs=0.05)


def test_a_stack_is_merged_with_its_measured_sensor(captured, product):
    """The radiance of the nominal pixel: without dark current, vignetting and the pixels' own response."""
    folder, rig = captured
    with Session.open(folder / "white") as session:
        (stack,) = stacks(session.frames())
    merged, plain = (merge(stack, known) for known in (load_calibrations([folder / "sensor"]), Calibrations()))
    true = rig.control("truth", what="sensor", camera="cam4")
    dark, flat = np.load(true["dark_path"]), nominal(np.load(true["flat_path"]))
    lines = map(json.loads, (rig.state / "truth" / "frames.jsonl").read_text().splitlines())
    mosaic = np.load(rig.state / "truth" / {line["id"]: line["radiance"] for line in lines}[merged.unique_ids[0]])
    assert (merged.radiance.status == PixelStatus.HOT).sum() == (dark > 100).sum()
    error = pull(merged.radiance, (mosaic - dark) / flat)
    # The gain's own 0.15 % beside noise of 0.9 % to 2 %.
    assert np.sqrt(np.mean(error**2)) == pytest.approx(1, abs=0.05)
    assert np.sqrt(np.mean(pull(plain.radiance, mosaic) ** 2)) > 1.1  # the nominal gain and a bent curve


def pull(radiance, truth):
    clear = (radiance.status == PixelStatus.OK) & (truth < 3e5)
    return (radiance.value - truth)[clear] / np.sqrt(radiance.variance[clear])


def nominal(flat):
    """With mean 1 in each phase of the mosaic."""
    for r, c in ((0, 0), (0, 1), (1, 0), (1, 1)):
        flat[r::2, c::2] /= flat[r::2, c::2].mean()
    return flat


def test_a_sensor_of_another_size_is_refused_in_one_line(captured, product, tmp_path):
    folder, _ = captured
    small = SensorCalibration.load(product)
    maps = {one.name: getattr(small.correction, one.name)[:-2] for one in fields(small.correction)}
    cut = replace(small, measurement=replace(small.measurement, correction=replace(small.correction, **maps)))
    shutil.copytree(folder / "sensor", tmp_path / "cut")
    cut.save(tmp_path / "cut" / "products" / "sensors" / "VC-0004")
    with Session.open(folder / "white") as session:
        (stack,) = stacks(session.frames())
        with pytest.raises(CalibrationError, match=r"its maps have 320 x 238 pixels, the frames 320 x 240"):
            merge(stack, load_calibrations([tmp_path / "cut"]))
