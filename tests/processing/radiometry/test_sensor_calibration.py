"""The product of a measured sensor: what is saved is what is loaded, and it fits its own frames only."""

import shutil
from dataclasses import asdict, replace

import numpy as np
import pytest

from processing.errors import CalibrationError, ImageError
from processing.formats.exr import read_exr
from processing.products.provenance import Provenance
from processing.radiometry.bracket import merge_files
from processing.radiometry.photon_transfer import measure_sensor
from processing.radiometry.sensor_calibration import SensorCalibration
from service.measuring import merge_photographs
from service.viewing import draw_product
from tests.reference.dng import dng
from tests.reference.sensor_frames import Camera

SHAPE = (64, 80)


@pytest.fixture(scope="module")
def calibration():
    camera = Camera(0, SHAPE)
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


def bracket(folder, serial="VC-0004", iso=100):
    """DNG files of an even grey field, as that camera takes them."""
    camera, paths = Camera(0, SHAPE), []
    for exposure_s in (0.02, 0.2):
        path = folder / f"{exposure_s}.dng"
        frame = camera.frame(exposure_s, 20000 * camera.flat, ("grey", repr(exposure_s)))
        tags = {"exposure_s": exposure_s, "serial": serial, "iso": iso, "noise_profile": camera.model.noise_profile()}
        path.write_bytes(dng(frame.raw_dn, **tags))
        paths.append(path)
    return camera, paths


def test_files_of_the_camera_are_merged_with_its_sensor(calibration, tmp_path):
    camera, paths = bracket(tmp_path)
    calibration.save(tmp_path / "VC-0004")
    lines = list(merge_photographs(paths, tmp_path / "out.exr", sensor=tmp_path / "VC-0004"))
    assert str(tmp_path / "out.exr") in lines[-2]
    written = read_exr(tmp_path / "out.exr")
    assert written.metadata["measuredSensor"] == f"VC-0004 {calibration.digest()}"
    plain = merge_files(paths).radiance.value[..., 1]
    # Noise of 1 % leaves the mean of 5000 pixels 0.02 %, the measured gain 0.3 %; the nominal gain is 1.3 % off.
    gain = camera.unit.sensor.gain_e_per_dn
    assert abs(gain / 4 - 1) > 0.005
    assert np.mean(written.image[..., 1]) == pytest.approx(20000, rel=0.004)
    assert np.mean(plain) != pytest.approx(20000, rel=0.004)


@pytest.mark.parametrize(("serial", "iso"), [("VC-0005", 100), ("", 100), ("VC-0004", 400)])
def test_files_of_another_camera_or_iso_are_refused(calibration, tmp_path, serial, iso):
    _, paths = bracket(tmp_path, serial, iso)
    with pytest.raises(CalibrationError, match=f"VC-0004 at ISO 100, the frames are of .* at ISO {iso}"):
        merge_files(paths, sensor=calibration)


def test_pictures_are_not_of_a_sensor(calibration, tmp_path):
    with pytest.raises(ImageError, match="no RAW file"):
        merge_files([tmp_path / "a.jpg", tmp_path / "b.jpg"], sensor=calibration)


def test_linear_counts_keep_order_and_saturation(calibration):
    codes = np.arange(4096, dtype=np.uint16)
    linear = calibration.linear_dn(codes)
    assert (np.diff(linear) > 0).all()
    saturation = calibration.measurement.figures["saturation_dn"].value
    assert ((linear >= calibration.sensor.white_dn) == (codes >= saturation)).all()
    assert linear[256] == pytest.approx(256, abs=0.01)  # nothing is bent near black


def test_the_picture_is_drawn(calibration, tmp_path):
    calibration.save(tmp_path)
    assert "sensor" in draw_product(tmp_path, tmp_path / "sensor.png", "", (), 100)
    assert (tmp_path / "sensor.png").stat().st_size > 20_000
