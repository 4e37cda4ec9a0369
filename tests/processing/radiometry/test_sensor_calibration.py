"""The product of a measured sensor: what is saved is what is loaded, and it fits its own frames only."""

import shutil
from dataclasses import asdict, replace

import numpy as np
import pytest

from processing.errors import CalibrationError, ImageError
from processing.products.provenance import Provenance
from processing.radiometry.photon_transfer import measure_sensor
from processing.radiometry.sensor_calibration import SensorCalibration
from service.viewing import draw_product
from tests.reference.sensor_frames import Camera

SHAPE = (64, 80)


@pytest.fixture(scope="module")
def calibration():
    camera = Camera(4, SHAPE)
    found = measure_sensor(camera.dark(), camera.flats(), camera.stated)
    source = Provenance(("sensor-1",), "", {"frames_sha256": "f"})
    return SensorCalibration("VC-0004", "Camera", 100, camera.stated, found, "2026-01-01T08:00:00+00:00", source)


@pytest.mark.parametrize("iso", [100.0, float("nan")])
def test_a_copied_folder_holds_the_same_sensor(calibration, tmp_path, iso):
    written = replace(calibration, iso=iso)
    written.save(tmp_path / "made")
    shutil.copytree(tmp_path / "made", tmp_path / "copy")
    shutil.rmtree(tmp_path / "made")
    loaded = SensorCalibration.load(tmp_path / "copy")
    assert loaded.digest() == written.digest()
    assert str(loaded.iso) == str(iso)
    for name in ("serial", "model", "date_utc", "sensor", "stated", "provenance"):
        assert getattr(loaded, name) == getattr(written, name)
    for name, figure in written.measurement.figures.items():
        np.testing.assert_equal(asdict(loaded.measurement.figures[name]), asdict(figure))
    for name in ("transfer", "correction"):
        saved, read = (asdict(getattr(one.measurement, name)) for one in (written, loaded))
        for key, values in saved.items():
            np.testing.assert_array_equal(read[key], values)


def test_another_number_is_another_identity(calibration):
    sensor = replace(calibration.sensor, gain_e_per_dn=calibration.sensor.gain_e_per_dn + 1e-9)
    other = replace(calibration, measurement=replace(calibration.measurement, sensor=sensor))
    assert other.digest() != calibration.digest()


@pytest.mark.parametrize("name", ["maps.npz", "product.json"])
def test_a_damaged_folder_is_named(calibration, tmp_path, name):
    calibration.save(tmp_path)
    whole = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ImageError, match=name):
        SensorCalibration.load(tmp_path)


def test_frames_of_another_size_or_setting_do_not_fit(calibration):
    calibration.check_fits(SHAPE, calibration.stated)
    with pytest.raises(CalibrationError, match=r"VC-0004: its maps have 80 x 64 pixels, the frames 640 x 480"):
        calibration.check_fits((480, 640), calibration.stated)
    with pytest.raises(CalibrationError, match="frames state 512 to 4095"):
        calibration.check_fits(SHAPE, replace(calibration.stated, black_dn=512))


def test_linear_counts_keep_order_and_saturation(calibration):
    codes = np.arange(4096, dtype=np.uint16)
    linear = calibration.linear_dn(codes)
    assert (np.diff(linear) > 0).all()
    saturation = calibration.measurement.figures["saturation_dn"].value
    assert ((linear >= calibration.sensor.white_dn) == (codes >= saturation)).all()
    assert linear[256] == pytest.approx(256, abs=0.01)  # nothing is bent near black


def test_the_picture_is_drawn(calibration, tmp_path):
    calibration.save(tmp_path)
    assert "sensor" in draw_product(tmp_path, tmp_path / "sensor.png", "", (0, 0), 100)
    assert (tmp_path / "sensor.png").stat().st_size > 20_000
