"""The camera driver against a scripted PTP/IP camera."""

import numpy as np
import pytest

from rig.config import CameraConfig
from rig.devices import FileFormat
from rig.drivers.camera import PtpCamera
from rig.drivers.frame_file import read_facts
from rig.errors import (
    ConnectError,
    DeviceError,
    FrameCheckError,
    FrameError,
    LimitError,
    ReadTimeoutError,
    ReplyError,
    StateError,
    TransportError,
)
from tests.reference.jpeg import jpeg
from tests.rig.drivers.ptp_peer import CameraPeer, dng

GET_HANDLES, GET_OBJECT, DELETE, CAPTURE, SET, TERMINATE = 0x1007, 0x1009, 0x100B, 0x100E, 0x1016, 0x1018


@pytest.fixture
def script(clock):
    return CameraPeer(clock)


@pytest.fixture
def wire(tcp_peer, script):
    return tcp_peer(script.serve)


def driver(wire, clock):
    config = CameraConfig(
        address=wire.address,
        serial="VC-0000",
        mount="front",
        elevation_deg=0.0,
        distance_mm=1000.0,
        megabytes_per_s=20.0,
        frame_megabytes=0.5,
    )
    return PtpCamera("cam0", config, clock)


@pytest.fixture
def camera(wire, clock):
    camera = driver(wire, clock)
    camera.open()
    yield camera
    camera.close()


def test_a_single_frame_comes_with_serial_exposure_and_time(camera, script, clock):
    clock.sleep(5.0)
    camera.expose(1 / 30)
    (frame,) = camera.fetch()
    assert (frame.camera, frame.serial, frame.index, frame.taken_s) == ("cam0", "VC-0000", 0, 5.0)
    assert frame.exposure_s == pytest.approx(0.0333)
    assert frame.data == dng(exposure_ticks=333)
    assert script.objects == {}, "the card is left empty"


def test_exposures_are_rounded_to_a_tenth_of_a_millisecond(camera, script):
    camera.expose(0.01234)
    camera.fetch()
    assert script.written[0] == (0x500D, 4, 123)


def test_only_settings_that_change_are_sent(camera, script):
    for _ in range(2):
        camera.expose(0.1)
        camera.fetch()
    assert script.written == [(0x500D, 4, 1000), (0x5013, 2, 1)]


def test_a_burst_has_its_frames_in_order_with_the_times_that_the_camera_keeps(camera, script, clock):
    """7.5 Hz is 133.33 ms; the camera counts whole milliseconds, and so do the frames' times."""
    script.frame = lambda index, ticks: dng(exposure_ticks=ticks, pixels=64 + index)
    started_s = clock.now_s()
    camera.expose(0.02, frames=5, interval_s=1 / 7.5)
    frames = camera.fetch()
    assert script.written == [(0x500D, 4, 200), (0x5013, 2, 2), (0x5018, 2, 5), (0x5019, 2, 133)]
    assert [frame.index for frame in frames] == list(range(5))
    assert [frame.data for frame in frames] == [dng(exposure_ticks=200, pixels=64 + index) for index in range(5)]
    assert [frame.taken_s for frame in frames] == pytest.approx([started_s + index * 0.133 for index in range(5)])


@pytest.mark.parametrize(
    ("stamps", "usable"),
    [
        (["59.000000", "59.133000", "59.300000"], True),  # the third one late by 34 ms
        (["58.9000", "59.0330", "59.2000"], True),
        (["59.0000", None, "59.3000"], False),
        (["59.3000", "59.1330", "59.0000"], False),  # the clock was set
        (["61.0000", "62.0000", "63.0000"], False),  # no clock shows that
    ],
)
def test_frames_of_a_burst_are_as_far_apart_as_the_camera_says(camera, script, clock, stamps, usable):
    def frame(index, ticks):
        moment = stamps[index] and stamps[index].split(".")
        return dng(exposure_ticks=ticks, stamp=moment and (f"2026:01:01 23:59:{moment[0]}", moment[1]))

    script.frame = frame
    started_s = clock.now_s()
    camera.expose(0.02, frames=3, interval_s=1 / 7.5)
    times_s = np.array([taken.taken_s for taken in camera.fetch()]) - started_s
    assert times_s == pytest.approx([0.0, 0.133, 0.3] if usable else [0.0, 0.133, 0.266])


@pytest.mark.parametrize(("fraction", "told"), [("1234", True), ("123456", True), ("12  ", False), ("abcd", False)])
def test_a_stamp_is_used_from_milliseconds_on(fraction, told):
    """Hundredths of a second are coarser than the interval that the camera keeps by itself."""
    facts = read_facts("cam0", dng(stamp=("2026:01:01 08:00:00", fraction)))
    assert (facts.stamp_s is not None) == told


def test_fetching_waits_no_longer_than_exposure_and_readout(camera, clock):
    """0.5 s of exposure, 0.02 s of readout, 0.01 s between two looks."""
    started_s = clock.now_s()
    camera.expose(0.5)
    camera.fetch()
    assert 0.52 <= clock.now_s() - started_s <= 0.54


@pytest.mark.parametrize("exposure_s", [0.0, 0.00004, -1.0, 61.0, float("nan")])
def test_an_exposure_outside_the_cameras_range_exposes_nothing(camera, script, exposure_s):
    with pytest.raises(LimitError, match=r"cam0: an exposure of .* outside 0.0001 to 60 s; nothing was exposed"):
        camera.expose(exposure_s)
    assert script.captures == 0


@pytest.mark.parametrize(("frames", "interval_s"), [(0, 1.0), (2, 0.05), (2, 66.0), (65_536, 1.0)])
def test_an_impossible_burst_exposes_nothing(camera, script, frames, interval_s):
    with pytest.raises(LimitError, match="nothing was exposed"):
        camera.expose(0.1, frames=frames, interval_s=interval_s)
    assert script.captures == 0


def test_a_busy_camera_is_asked_again(camera, script):
    script.busy = {CAPTURE: 3, SET: 2}
    camera.expose(0.1)
    assert len(camera.fetch()) == 1
    assert script.operations.count(CAPTURE) == 4


def test_a_camera_that_stays_busy_is_told(camera, script):
    script.busy = {CAPTURE: 10_000}
    with pytest.raises(DeviceError, match="cam0: stays busy"):
        camera.expose(0.1)


def test_another_camera_on_the_cable_is_told_at_opening(wire, clock, script):
    script.serial = "VC-0005"
    with pytest.raises(DeviceError, match=r"cam0: expected serial VC-0000, found VC-0005 .*another port"):
        driver(wire, clock).open()


def test_a_camera_that_another_program_holds_is_told(wire, clock, script):
    script.refuses = True
    with pytest.raises(ConnectError, match=r"cam0: refuses the connection .*Is another program"):
        driver(wire, clock).open()


def test_a_frame_of_another_camera_is_refused(camera, script):
    script.frame = lambda index, ticks: dng(serial="VC-0005", exposure_ticks=ticks)
    camera.expose(0.1)
    with pytest.raises(FrameCheckError, match="cam0: expected serial VC-0000, frame carries VC-0005"):
        camera.fetch()


def test_a_frame_of_another_exposure_is_refused(camera, script):
    script.frame = lambda index, ticks: dng(exposure_ticks=2 * ticks)
    camera.expose(0.1)
    with pytest.raises(FrameCheckError, match=r"asked for 0.1 s, frame carries 0.2 s"):
        camera.fetch()


@pytest.mark.parametrize("kept", [0, 4, 60, 150, 200])
def test_a_cut_frame_is_refused_after_three_downloads(camera, script, kept):
    """Cut in the header, in the directory, in front of the pixels and among them."""
    camera.expose(0.1)
    script.strikes = 3 * [lambda file: file[:kept]]
    with pytest.raises(FrameCheckError, match=r"cam0: the frame .*(no DNG|is cut)"):
        camera.fetch()
    assert script.operations.count(GET_OBJECT) == 3


def test_a_download_that_failed_is_repeated(camera, script):
    camera.expose(0.1)
    script.strikes = [lambda file: file[:150]]
    (frame,) = camera.fetch()
    assert frame.data == dng(exposure_ticks=1000)


def test_lost_events_are_made_up_for_by_looking_at_the_card(camera, script):
    script.events = False
    camera.expose(0.1, frames=3, interval_s=0.2)
    assert len(camera.fetch()) == 3


def test_a_frame_that_does_not_come_is_a_timeout_and_leaves_no_litter(camera, script):
    script.frames_missing = 1
    camera.expose(0.1, frames=3, interval_s=0.2)
    with pytest.raises(ReadTimeoutError, match="cam0: 2 of 3 frames came"):
        camera.fetch()
    script.frames_missing = 0
    camera.expose(0.1)
    assert len(camera.fetch()) == 1
    assert script.objects == {}


def test_what_was_on_the_card_before_stays_there(wire, clock, script):
    script.objects = {77: b"the photographer's own"}
    camera = driver(wire, clock)
    camera.open()
    script.events = False
    camera.expose(0.1)
    assert len(camera.fetch()) == 1
    camera.expose(0.1)
    camera.abort()
    clock.sleep(1.0)
    camera.expose(0.1)
    camera.fetch()
    assert script.objects == {77: b"the photographer's own"}
    camera.close()


def test_exposures_follow_each_other_only_by_fetch_or_abort(camera):
    with pytest.raises(StateError, match="nothing was exposed"):
        camera.fetch()
    camera.expose(0.1)
    with pytest.raises(StateError, match="under way"):
        camera.expose(0.1)
    camera.abort()
    camera.expose(0.1)
    assert len(camera.fetch()) == 1


def test_an_abort_ends_a_burst_where_the_camera_knows_how(camera, script):
    camera.abort()
    assert TERMINATE not in script.operations
    camera.expose(0.1, frames=50, interval_s=0.2)
    camera.abort()
    assert script.operations.count(TERMINATE) == 1


def test_a_late_answer_is_not_taken_for_that_of_the_next_operation(camera, script):
    """Each transaction has a number; packets of another one are dropped."""
    script.mute = [CAPTURE]
    with pytest.raises(ReadTimeoutError, match="INITIATE_CAPTURE"):
        camera.expose(0.1)
    camera.expose(0.1)
    assert len(camera.fetch()) == 1


def test_a_frame_whose_start_went_unconfirmed_is_not_taken_for_the_next(camera, script, clock):
    """The camera exposed, its answer was lost: the frame that it stores meanwhile belongs to nobody."""
    script.mute = [CAPTURE]
    script.frame = lambda index, ticks: dng(exposure_ticks=ticks, pixels=64 + script.captures)
    with pytest.raises(ReadTimeoutError):
        camera.expose(5.0)
    camera.expose(5.0)
    (frame,) = camera.fetch()
    assert frame.data == dng(exposure_ticks=50_000, pixels=66)
    camera.expose(0.1)
    camera.fetch()
    assert script.objects == {}


def test_after_a_cut_answer_the_connection_is_opened_anew(camera, script):
    """On a byte stream nothing tells where the next answer begins."""
    script.response_bytes = 7
    with pytest.raises(FrameError, match="what came is no reply to SET_PROPERTY_VALUE"):
        camera.expose(0.1)
    camera.expose(0.1)
    assert len(camera.fetch()) == 1


def test_a_probe_on_the_event_connection_is_answered(camera, script):
    camera.expose(0.1)
    script.probe()
    assert len(camera.fetch()) == 1
    assert script.ponged.wait(5.0)


def test_a_camera_that_was_unplugged_is_told_and_found_again(camera, wire, script):
    camera.expose(0.1)
    wire.hang_up()
    with pytest.raises(TransportError, match="cam0: lost"):
        camera.fetch()
    camera.expose(0.1)
    assert len(camera.fetch()) == 1


def test_a_camera_that_numbers_its_card_anew_keeps_the_photographers_own(wire, clock, script):
    """Handles hold for one PTP session only: after a lost connection nothing tells our frames from the others."""
    script.objects = {77: b"the photographer's own"}
    camera = driver(wire, clock)
    camera.open()
    camera.expose(0.1)
    wire.hang_up()
    with pytest.raises(TransportError):
        camera.fetch()
    script.objects = {5: b"the photographer's own"}
    camera.expose(0.1)
    camera.fetch()
    assert script.objects[5] == b"the photographer's own"
    camera.close()


def test_a_camera_that_cannot_be_set_up_is_not_left_half_open(wire, clock, script):
    camera = driver(wire, clock)
    script.busy = {GET_HANDLES: 1}
    with pytest.raises(ReplyError, match="busy"):
        camera.open()
    script.objects = {77: b"the photographer's own"}
    camera.expose(0.1)
    camera.abort()
    camera.expose(0.1)
    camera.fetch()
    assert 77 in script.objects
    camera.close()


def test_an_interval_is_not_rounded_below_the_exposure(camera, script):
    """133.3 ms of exposure at 7.5 Hz would not fit into 133 ms."""
    camera.expose(0.1333, frames=2, interval_s=1 / 7.5)
    camera.fetch()
    assert script.properties[0x5019] == 134


def test_the_forecast_of_the_download_is_bytes_over_bandwidth(camera):
    assert camera.transfer_time_s(8) == pytest.approx(8 * 0.5 / 20.0)


def test_a_refusal_is_told_with_code_and_bytes(camera, script):
    script.busy = {DELETE: 1}
    camera.expose(0.1)
    with pytest.raises(ReplyError, match=r"refuses DELETE_OBJECT: device busy \(0x2019\)"):
        camera.fetch()


def test_facts_are_read_from_the_files_own_tags():
    facts = read_facts("cam0", dng(serial="DS-0001", exposure_ticks=50_000))
    assert (facts.serial, facts.exposure_s) == ("DS-0001", 5.0)


PICTURE = np.arange(48 * 64).reshape(48, 64) % 251
SPEEDS = ((0, 0), (1, 32_000), (1, 8000), (1, 2))  # the first is the camera's own choice


@pytest.fixture
def phone(wire, clock, script):
    """A camera of Ricoh's, which is told shutter speeds and has JPEG and DNG."""
    script.speeds, script.formats = SPEEDS, (0x3801, 0x3811)
    script.frame = lambda index, ticks: jpeg(PICTURE, serial="VC-0000", exposure_s=1 / 32_000)
    camera = driver(wire, clock)
    camera.open()
    yield camera
    camera.close()


def test_a_shutter_speed_is_told_as_the_camera_lists_it(phone, script):
    """1/32000 s, which tenths of a millisecond are too coarse for."""
    phone.expose(3.1e-5, file_format=FileFormat.JPEG)
    (frame,) = phone.fetch()
    assert (frame.exposure_s, frame.iso, frame.file_format) == (1 / 32_000, 100, FileFormat.JPEG)
    assert script.written[0] == (0xD00F, 8, 32_000 << 32 | 1)
    assert script.asked == [0x3801]
    script.frame = lambda index, ticks: dng(exposure_ticks=5000)
    phone.expose(0.5)
    assert phone.fetch()[0].file_format is FileFormat.RAW
    assert script.asked == [0x3801, 0x3811]


def test_what_the_phone_cannot_is_refused_before_anything_is_exposed(phone, script):
    with pytest.raises(LimitError, match=r"no shutter speed of 0\.25 s; the nearest of 3 is 0\.5 s \(1/2\)"):
        phone.expose(0.25)
    with pytest.raises(LimitError, match="no shutter speed"):
        phone.expose(1 / 64_000)
    assert script.captures == 0


def test_a_camera_without_jpeg_says_so(camera, script):
    with pytest.raises(LimitError, match="delivers no JPEG"):
        camera.expose(0.1, file_format=FileFormat.JPEG)
    camera.expose(0.0333)
    camera.fetch()
    assert script.asked == [0], "raw files of another camera may have a format of their own"


def test_another_format_or_exposure_than_asked_for_is_refused(phone, script):
    phone.expose(1 / 32_000)
    with pytest.raises(FrameCheckError, match=r"asked for \.dng, a \.jpg came"):
        phone.fetch()
    phone.expose(1 / 8000, file_format=FileFormat.JPEG)  # within a tick of what comes, yet two stops from it
    with pytest.raises(FrameCheckError, match=r"asked for 0\.000125 s"):
        phone.fetch()


def test_a_cut_photograph_is_fetched_again(phone, script):
    script.strikes = [lambda file: file[: len(file) // 2]]
    phone.expose(1 / 32_000, file_format=FileFormat.JPEG)
    (frame,) = phone.fetch()
    assert frame.data == jpeg(PICTURE, serial="VC-0000", exposure_s=1 / 32_000)


def test_facts_of_a_photograph_are_those_of_its_exif_data():
    data = jpeg(PICTURE, serial="PH-0001", exposure_s=1 / 32_000, iso=50, stamp=("2026:01:01 08:00:00", "250"))
    facts = read_facts("phone", data)
    assert (facts.serial, facts.exposure_s, facts.iso) == ("PH-0001", 1 / 32_000, 50)
    assert facts.stamp_s % 1 == 0.25
    assert np.isnan(read_facts("phone", jpeg(PICTURE, iso=None)).iso)


@pytest.mark.parametrize("missing", ["serial", "exposure_s"])
def test_a_photograph_that_leaves_out_what_tells_it_apart_is_refused(missing):
    with pytest.raises(FrameCheckError, match="no DNG or JPEG with serial number and exposure time"):
        read_facts("phone", jpeg(PICTURE, **{missing: None}))


def test_every_cut_of_a_photograph_is_seen():
    data = jpeg(PICTURE)
    for length in range(0, len(data), 37):
        with pytest.raises(FrameCheckError):
            read_facts("phone", data[:length])


@pytest.mark.parametrize("data", [b"", b"\xff\xd8\xff\xe0" + bytes(100), b"not an image" * 50])
def test_what_is_no_raw_file_is_refused(data):
    with pytest.raises(FrameCheckError, match="no DNG"):
        read_facts("cam0", data)
