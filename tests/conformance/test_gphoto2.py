"""Stock gphoto2 drives a camera over PTP/IP."""

import socket

import pytest
import rawpy
from PIL import Image


@pytest.fixture
def gphoto2(live_rig, command):
    """gphoto2 on a camera of this name; the second number is the port of the event connection."""

    def gphoto2(name, *arguments):
        host, port = live_rig.camera_address(name).split(":")
        return command("gphoto2", "--port", f"ptpip:{host}:{port}:{port}", *arguments)

    return gphoto2


def test_summary_names_the_camera(gphoto2):
    summary = gphoto2("cam2", "--summary")
    assert summary.returncode == 0, summary.stderr
    assert "Serial Number: VC-0002" in summary.stdout
    assert "Exposure Time(0x500d):(readwrite)" in summary.stdout
    assert "Burst Number(0x5018)" in summary.stdout


def test_settings_are_read_and_written(gphoto2):
    assert "Current: 100" in gphoto2("cam2", "--get-config", "iso").stdout
    written = gphoto2("cam2", "--set-config", "500d=250", "--get-config", "500d")
    assert written.returncode == 0, written.stderr
    assert "Current: 250" in written.stdout
    assert gphoto2("cam2", "--set-config", "500d=0").returncode != 0


def test_capture_and_download_is_a_raw_file(gphoto2, live_rig, tmp_path):
    live_rig.control("mount", sample="white")
    captured = gphoto2("cam3", "--set-config", "500d=333", "--capture-image-and-download", "--filename", "shot.dng")
    assert captured.returncode == 0, captured.stderr
    with rawpy.imread(str(tmp_path / "shot.dng")) as raw:
        assert raw.raw_image.shape == (240, 320)
    listing = gphoto2("cam3", "--list-files")
    assert "There is no file" in listing.stdout, "gphoto2 deletes what it has downloaded"


def test_files_stay_on_the_camera_until_deleted(gphoto2, tmp_path):
    assert gphoto2("cam4", "--capture-image").returncode == 0
    assert "IMG_00001.DNG" in gphoto2("cam4", "--list-files").stdout
    assert gphoto2("cam4", "--get-file", "1", "--filename", "kept.dng").returncode == 0
    assert (tmp_path / "kept.dng").stat().st_size > 2 * 240 * 320
    assert gphoto2("cam4", "--delete-all-files", "--folder", "/store_00010001").returncode == 0
    assert "There is no file" in gphoto2("cam4", "--list-files").stdout


def test_cameras_answer_at_one_port_of_their_own_addresses(start_simulators, command):
    """As on a real network: the same port everywhere, one address per camera."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    rig = start_simulators("--rate", "20", "--ptp-port", str(port))
    for name, serial, host in (("cam0", "VC-0000", "127.0.0.1"), ("front", "DS-0001", "127.0.0.9")):
        assert rig.camera_address(name) == f"{host}:{port}"
        summary = command("gphoto2", "--port", f"ptpip:{host}:{port}:{port}", "--summary")
        assert f"Serial Number: {serial}" in summary.stdout


def test_the_phone_takes_a_jpeg_that_says_who_took_it(gphoto2, live_rig, tmp_path):
    live_rig.control("mount", place="room", facing="front")
    captured = gphoto2("phone", "--capture-image-and-download", "--filename", "shot.jpg")
    assert captured.returncode == 0, captured.stderr
    with Image.open(tmp_path / "shot.jpg") as picture:
        assert picture.size == (300, 260)
        assert picture.getexif().get_ifd(0x8769)[0xA431] == "PH-0001"
    assert "Serial Number: PH-0001" in gphoto2("phone", "--summary").stdout
