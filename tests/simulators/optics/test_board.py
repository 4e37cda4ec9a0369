import io

import cv2
import numpy as np
import pytest
import rawpy

from simulators.lens import project
from simulators.light import CHANNELS


def _corners(picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inner corners that OpenCV finds: image points and points of its board (x right, y down from the top left).

    Refined in a window of 3 px: the markers begin 3 px beside the corners and would draw them away.
    """
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    board = cv2.aruco.CharucoBoard((7, 5), 0.012, 0.009, dictionary)
    found, ids, *_ = cv2.aruco.CharucoDetector(board).detectBoard(picture)
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-4)
    found = cv2.cornerSubPix(picture, found.reshape(-1, 1, 2), (3, 3), (-1, -1), criteria)
    return found.reshape(-1, 2), board.getChessboardCorners()[ids.ravel()]


def _grey(data: bytes) -> np.ndarray:
    """The board is grey: dividing by the sensor's response to white makes every pixel a brightness."""
    with rawpy.imread(io.BytesIO(data)) as raw:
        level = raw.raw_image.astype(float) - 256
    rows, columns = np.indices(level.shape)
    even = level / CHANNELS[rows % 2 + columns % 2]
    return np.clip(even / even.max() * 255, 0, 255).astype(np.uint8)


@pytest.mark.parametrize(("camera", "board_pose"), [("cam7", 0), ("cam4", 0), ("cam4", 1), ("cam3", 2), ("cam5", 3)])
def test_corners_are_where_the_projection_says(optics, pose, camera, board_pose):
    lit = pose(sample="charuco", board_pose=board_pose, light_arc_rad=1.0, lamps=(("lamp6", 1.0),))
    data = optics.photograph(camera, lit, 0.2, serial="VC", frame_key=("board", board_pose), time_s=0.0)
    uv, on_board = _corners(_grey(data))
    assert len(uv) >= 18  # of 24
    centred = np.column_stack([on_board[:, 0] - 0.042, 0.030 - on_board[:, 1], on_board[:, 2]])
    rig_from_board = optics.layout.rig_from_board(board_pose)
    points = centred @ rig_from_board[:3, :3].T + rig_from_board[:3, 3]
    off = uv - project(optics.layout.cameras[camera], points)
    assert np.sqrt(np.mean(np.sum(off**2, axis=1))) < 0.1
    assert np.linalg.norm(off.mean(axis=0)) < 0.05  # no common shift


def test_edges_lie_where_the_projection_says(optics, pose):
    """Light integrated across an edge between known albedos tells its place, in a picture without noise."""
    rate = optics.rate("cam7", pose(sample="charuco", light_arc_rad=1.0, lamps=(("lamp6", 1.0),)))
    rows, columns = np.indices(rate.shape)
    grey = rate / (CHANNELS * optics.layout.lamps["lamp6"].gains)[rows % 2 + columns % 2]
    for square in range(1, 7):
        board = optics.layout.rig_from_board(0)
        point = board[:3, :3] @ [square * 0.012 - 0.042, 0.030 - 0.030, 0.0] + board[:3, 3]
        u, v = project(optics.layout.cameras["cam7"], point[None])[0]
        line, i = grey[:, round(u)], round(v)
        black = min(line[i - 4], line[i + 4])
        bright = black * 0.85 / 0.04
        from_white = slice(i - 1, i + 5) if line[i - 2] > line[i + 2] else slice(i - 4, i + 2)
        dark_px = np.sum((bright - line[from_white]) / (bright - black))
        edge = i + 4.5 - dark_px if line[i - 2] > line[i + 2] else i - 4.5 + dark_px
        # The board lies a fifth of a degree askew and the line is up to half a pixel beside the point: 0.002 px.
        assert edge == pytest.approx(v, abs=0.022)


def test_the_back_of_the_board_is_not_seen(studio):
    scene = studio.scene("charuco")
    assert len(scene.trace(np.array([0, 0, -1.0]), np.array([[0, 0, 1.0]])).ray) == 0
