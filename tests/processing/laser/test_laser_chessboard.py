"""The laser's plane from photographs of its line on a chessboard that tell the camera as well."""

import numpy as np
import pytest
from PIL import Image

from processing.errors import CalibrationError, ImageError
from processing.laser.laser_chessboard import Chessboard, laser_chessboard
from processing.laser.plane_fit import plane_angle
from processing.laser.stripe import LaserColour
from tests.public_data import DATA
from tests.reference.board_photographs import (
    COLUMNS,
    MATRIX,
    NORMAL,
    OFFSET_M,
    ROWS,
    SQUARE_M,
    TILTS,
    write_photographs,
)

PUBLISHED = DATA / "laser-chessboard"
BOARD = Chessboard(COLUMNS, ROWS, SQUARE_M)


@pytest.fixture(scope="module", params=[LaserColour.RED, LaserColour.GREEN, LaserColour.BLUE])
def photographs(tmp_path_factory, request):
    folder = tmp_path_factory.mktemp(request.param)
    write_photographs(folder, list(LaserColour).index(request.param))
    return folder, request.param


def test_camera_and_plane_are_those_of_the_scene(photographs):
    """Within what six small pictures can tell: a hundredth of the focal length, half a degree, half a millimetre."""
    found = laser_chessboard(*photographs, BOARD)
    assert len(found.stripes) == len(TILTS)
    assert found.calibration.size_px == (400, 300)
    assert found.calibration.corner_rms_px < 0.1
    np.testing.assert_allclose(found.calibration.matrix, MATRIX, atol=5.0)
    assert np.degrees(np.arccos(found.plane.normal @ NORMAL)) < 0.5
    assert abs(np.mean(found.points_m @ NORMAL) - OFFSET_M) < 0.5e-3
    assert found.plane.rms_m < 0.2e-3


def test_pictures_without_the_whole_board_or_the_line_are_left_out(tmp_path):
    write_photographs(tmp_path)
    with Image.open(tmp_path / "view0.png") as picture:
        pixels = np.asarray(picture).copy()
    Image.fromarray(pixels[..., [1, 1, 1]]).save(tmp_path / "unlit.png")
    pixels[:, 200:] = 90
    Image.fromarray(pixels).save(tmp_path / "half.png")
    found = laser_chessboard(tmp_path, board=BOARD)
    assert len(found.calibration.photographs) == len(TILTS) + 1
    assert sorted(stripe.image for stripe in found.stripes) == [f"view{k}.png" for k in range(len(TILTS))]


def test_what_cannot_be_measured_is_said(tmp_path):
    write_photographs(tmp_path, tilts=TILTS[:3])
    with pytest.raises(ImageError, match=r"9 x 6 inner corners in 0 of 3 pictures"):
        laser_chessboard(tmp_path, board=Chessboard(9, 6, SQUARE_M))
    with pytest.raises(ImageError, match="stripe on 0 of 3 boards"):
        laser_chessboard(tmp_path, LaserColour.GREEN, BOARD)
    for path in tmp_path.iterdir():
        with Image.open(path) as picture:
            grey = picture.convert("L")
        grey.save(path)
    with pytest.raises(ImageError, match="a colour image"):
        laser_chessboard(tmp_path, board=BOARD)


def test_one_view_over_and_over_tells_no_camera(tmp_path):
    write_photographs(tmp_path, tilts=3 * TILTS[:1])
    with pytest.raises(CalibrationError, match=tmp_path.name):
        laser_chessboard(tmp_path, board=BOARD)


@pytest.mark.long
@pytest.mark.skipif(not PUBLISHED.is_dir(), reason="shared data laser-chessboard is absent")
def test_photographs_alone_give_the_plane_of_the_published_calibration():
    """Two calibrations of one camera of the same corners: within three of the plane's own deviations."""
    theirs, ours = laser_chessboard(PUBLISHED), laser_chessboard(PUBLISHED, board=Chessboard(11, 7, 0.021167))
    assert len(ours.stripes) == len(theirs.stripes) == 14
    assert plane_angle(ours.plane, theirs.plane) < 3 * theirs.angle_deviation_rad
    assert ours.plane.rms_m < 1.05 * theirs.plane.rms_m
