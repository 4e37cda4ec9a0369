"""An mdf session on the simulated rig, its product, and sweeps that are damaged, dark or of a measured sensor."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import zarr

from processing.cameras.calibration import CameraModel, write_cameras
from processing.cameras.lens import Pinhole
from processing.errors import ImageError
from processing.laser.laser_plane import SweepStatus
from processing.laser.mdf import mdf_from_sweeps
from processing.products import Mdf
from processing.radiometry.linearity import Linearity
from processing.radiometry.photon_transfer import Measured, SensorMeasurement, Transfer
from processing.radiometry.sensor import PixelCorrection, Sensor
from processing.radiometry.sensor_calibration import SensorCalibration
from rig.config import load_config
from rig.sessions import Session, parse_plan
from service.capture import capture
from service.pipeline import mdf as pipeline
from service.pipeline import process
from service.pipeline.calibrations import CALIBRATION, CAMERAS, Calibrations, load_calibrations
from service.simulation import Simulation
from service.truth import MdfErrors, mdf_errors

PLAN = {
    "kind": "mdf", "sample": "brick", "turntable_deg": [0], "laser_azimuth_deg": [60, -120],
    "laser_elevations_deg": [50], "cameras": ["cam7", "cam4"], "exposure_s": 0.03, "frame_rate_hz": 7.5, "texels": 24,
}  # fmt: skip


class Watcher:
    """Keeps what it is told."""

    def __init__(self):
        self.notes = []

    def track(self, items, description):
        yield from items

    def note(self, text):
        self.notes.append(text)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """The processed session, its calibrations, what was noted, and its errors."""
    folder = tmp_path_factory.mktemp("mdf")
    known, watcher = folder / "board" / "products" / CALIBRATION, Watcher()
    known.mkdir(parents=True)
    with Simulation(folder / "simulation", seed=1) as simulation:
        true = simulation.request("truth", what="cameras")["cameras"]
        write_cameras({name: camera_model(one) for name, one in true.items()}, known / CAMERAS)
        capture(
            parse_plan(PLAN), load_config(simulation.rig_toml), folder / "mdf",
            operator=simulation.mount, on_event=lambda event: None,
        )  # fmt: skip
        with Session.open(folder / "mdf") as session:
            product = process(session, [folder / "board"], watcher)[0]
            made = (product / "product.json").stat().st_mtime_ns
            assert process(session, [folder / "board"], watcher) == [product]
            assert (product / "product.json").stat().st_mtime_ns == made  # nothing changed: not made again
            yield (
                session,
                load_calibrations([folder / "board"]),
                product,
                watcher.notes,
                mdf_errors(session, simulation),
            )


def camera_model(true):
    lens = Pinhole(np.asarray(true["matrix"]), np.asarray([*true["distortion"], 0, 0, 0]))
    return CameraModel(lens, np.asarray(true["rig_from_camera"]), (true["height_px"], true["width_px"]))


def test_the_product_is_the_surface_and_says_what_it_rests_on(done):
    session, _, product, notes, errors = done
    mdf, told = Mdf.load(product), json.loads((product / "product.json").read_text())["content"]["views"]
    assert [view["view"] for view in told] == ["cam4 at +0.00 deg", "cam7 at +0.00 deg"]
    assert mdf.displacement_m.shape == (2, 24, 24)
    assert mdf.view_directions[1, 2] > 0.99
    assert errors.completeness > 0.9  # two locations reach few places twice
    assert errors.error_m.median < 40e-6
    assert errors.false_points < 0.01
    assert errors.within_one_code_step > 0.2  # a pixel of the small rig is half a millimetre wide
    assert notes == []
    for view in told:
        assert (product / view["picture"]).stat().st_size > 20_000
        assert {sweep["laser_azimuth_deg"] for sweep in view["sweeps"]} == {60, -120}
        for sweep in view["sweeps"]:
            assert sweep["status"] == "OK"
            assert 0.5 < sweep["consistency"] < 1.5
            assert 0.3 < sweep["completeness"] < 1
    assert {record.step.id for record in session.frames()} == {s["step"] for view in told for s in view["sweeps"]}


def test_packed_to_a_byte_it_is_the_same_to_half_a_step(done):
    mdf = Mdf.load(done[2])
    code, scale_m = mdf.pack8()
    measured = np.isfinite(mdf.displacement_m)
    assert code.dtype == np.uint8
    assert (measured == (code != 255)).all()
    assert np.abs(code[measured] * scale_m - mdf.displacement_m[measured]).max() <= 0.501 * scale_m


def test_a_sweep_without_a_stripe_is_left_out_and_told(done):
    """The laser's beam blocked by something in one of two sweeps."""
    session, calibrations = done[:2]
    records = [record for record in session.frames() if record.camera == "cam4"]
    sweeps = [pipeline._sweep(record, session.config, calibrations) for record in records]
    dark = np.repeat(next(iter(sweeps[1].frames))[None], 92, axis=0)
    _, (view,) = mdf_from_sweeps([sweeps[0], replace(sweeps[1], frames=dark)], pipeline._holder(session.config), 8)
    told = pipeline._told(view, records)
    assert [sweep["status"] for sweep in told["sweeps"]] == ["OK", "NO_STRIPE"]
    assert told["sweeps"][1]["consistency"] is None
    (trouble,) = pipeline._troubles(told)
    assert "cam4 at +0.00 deg, laser -120 deg round, 50 up: no laser stripe" in trouble


def test_sweeps_that_contradict_the_others_are_told():
    sweep = {"laser_azimuth_deg": 60.0, "laser_elevation_deg": 50.0, "completeness": 0.9}
    found = [
        sweep | {"status": status.name, "consistency": consistency}
        for status in SweepStatus
        for consistency in (None, 1.0, 3.0)
    ]
    told = [list(pipeline._troubles({"view": "cam4", "sweeps": [one]})) for one in found]
    assert [len(texts) for texts in told] == [0, 0, 1, 1, 1, 1, 1, 1, 1]
    assert "3.0 of its own sigmas" in told[2][0]


def test_a_damaged_sweep_is_one_clear_error(done, tmp_path):
    """An array without its description, and one with a chunk that was overwritten."""
    frames = np.random.default_rng(1).integers(200, 300, (20, 48, 64)).astype(np.uint16)
    path = tmp_path / "cam4.zarr"
    zarr.create_array(path, data=frames, chunks=(8, 48, 64), attributes={"a": 1})
    stored, about = pipeline._opened(path)
    assert about == {"a": 1}
    np.testing.assert_array_equal(np.stack(list(pipeline._frames(stored, path, None))), frames)
    for chunk in (p for p in path.rglob("*") if p.is_file() and p.name != "zarr.json"):
        chunk.write_bytes(b"no chunk")
    with pytest.raises(ImageError, match=r"cam4\.zarr: this laser sweep cannot be read"):
        list(pipeline._frames(stored, path, None))
    (path / "zarr.json").unlink()
    with pytest.raises(ImageError, match="rig verify"):
        pipeline._opened(path)


def test_frames_have_their_own_times_where_they_were_noted(done):
    session, calibrations = done[:2]
    sweep = pipeline._sweep(session.frames()[0], session.config, calibrations)
    assert sweep.times[0] == 0
    assert len(sweep.times) == len(list(sweep.frames)) == 92
    assert all(0.9 < later - sooner < 1.1 for sooner, later in pairwise(sweep.times))
    assert pipeline._times({"interval_s": 0.1}) is None
    np.testing.assert_allclose(pipeline._times({"times_s": [5.0, 5.1, 5.35, 5.45]}), [0, 1, 3.5, 4.5])


def test_a_measured_sensor_straightens_counts_and_excludes_hot_pixels(done):
    session, calibrations = done[:2]
    record = session.frames()[0]
    plain = pipeline._sweep(record, session.config, calibrations)
    shape = plain.camera.size
    hot = np.zeros(shape, bool)
    hot[::7, ::5] = True
    sensor = measured_sensor(plain.sensor, hot)
    serial = str(pipeline._opened(record.path)[1]["serial"])
    sweep = pipeline._sweep(record, session.config, Calibrations(calibrations.cameras, {serial: sensor}))
    assert sweep.sensor == sensor.measurement.sensor
    raw, straight = (np.stack(list(one.frames)) for one in (plain, sweep))
    assert straight.dtype == np.uint16
    bright = raw > 1500
    assert bright.any()
    expected = sensor.measurement.linearity.linear_dn(raw[bright] - 256.0) + 256.0
    assert np.abs(straight[bright] - expected).max() <= 0.5
    _, (view,) = mdf_from_sweeps([replace(sweep, frames=straight)], pipeline._holder(session.config), 8)
    assert np.isnan(view.merged.displacement_m[hot]).all()
    assert np.isfinite(view.merged.displacement_m).any()


def measured_sensor(stated, hot):
    """Loses one percent at full scale."""
    linearity, nothing = Linearity(stated.white_dn - stated.black_dn, 0.01, 0.0), np.zeros(0)
    none = np.zeros(hot.shape, np.float32)
    white_dn = stated.black_dn + float(linearity.linear_dn(stated.white_dn - stated.black_dn))
    measurement = SensorMeasurement(
        Sensor(stated.black_dn, white_dn, stated.gain_e_per_dn, stated.read_noise_e),
        PixelCorrection(none, none, none + 1, hot),
        linearity,
        {"saturation_dn": Measured(stated.white_dn, 0.0), "offset_left_dn": Measured(0.0, 0.0)},
        Transfer(*[nothing] * 7),
    )
    return SensorCalibration("", "", 100.0, stated, measurement)


@pytest.mark.parametrize("lit", [False, True])
def test_shares_of_nothing_are_not_known(lit):
    """An MDF without a measured texel: complete by nothing where some can be measured, false points not known."""
    nothing = np.full((1, 4, 4), np.nan, np.float32)
    mdf = Mdf(nothing, nothing, np.array([[0.0, 0.0, 1.0]]), 0.1)
    errors = MdfErrors.of(mdf, np.zeros((1, 4, 4)), np.full((1, 4, 4), lit))
    np.testing.assert_equal(errors.completeness, 0.0 if lit else np.nan)
    np.testing.assert_equal(errors.within_one_code_step, 0.0 if lit else np.nan)
    assert np.isnan(errors.false_points)
