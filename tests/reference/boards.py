"""Pictures of a ChArUco board, drawn by casting rays: slow, simple, independent of the detector."""

import cv2
import numpy as np

from processing import geometry

_PER_SQUARE = 60  # texture pixels


def texture(board):
    """The board's print and its size in metres, white around it taken as part of the table."""
    size = (board.columns * _PER_SQUARE, board.rows * _PER_SQUARE)
    return board.detector_board().generateImage(size, marginSize=0).astype(np.float32)


def photograph_board(board, camera, rig_from_board, samples=3):
    """Gray image (h, w) uint8 of the board on a gray table: samples x samples rays a pixel."""
    rows, columns = camera.size
    inside = (np.arange(samples) + 0.5) / samples - 0.5
    v = (np.arange(rows)[:, None] + inside).ravel()
    u = (np.arange(columns)[:, None] + inside).ravel()
    uv = np.stack(np.meshgrid(u, v), axis=-1)
    met = geometry.intersect_plane(
        camera.centre_m, camera.rays(uv), rig_from_board[:3, 2], rig_from_board[:3, 2] @ rig_from_board[:3, 3]
    )
    local = geometry.transform_points(geometry.invert(rig_from_board), np.nan_to_num(met, nan=9.0))
    scale = _PER_SQUARE / board.square_m
    x = (local[..., 0] + board.columns * board.square_m / 2) * scale - 0.5
    y = (board.rows * board.square_m / 2 - local[..., 1]) * scale - 0.5
    drawn = cv2.remap(texture(board), x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR, borderValue=150)
    return drawn.reshape(rows, samples, columns, samples).mean(axis=(1, 3)).round().astype(np.uint8)
