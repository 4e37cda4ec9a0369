"""Photographs of a laser's line on a chessboard: three by three rays per pixel, cut with the board."""

import numpy as np
from PIL import Image

from processing import geometry

MATRIX = np.array([[500.0, 0, 203.0], [0, 500.0, 148.0], [0, 0, 1]])
SIZE = (300, 400)
COLUMNS, ROWS, SQUARE_M = 8, 5, 0.02  # inner corners
NORMAL = np.array([np.cos(0.5), 0.1, np.sin(0.5)]) / np.linalg.norm([np.cos(0.5), 0.1, np.sin(0.5)])
OFFSET_M = float(NORMAL @ [0.01, 0.0, 0.4])
TILTS = ((0.0, 0.3), (0.5, 0.0), (-0.5, 0.2), (0.2, -0.5), (-0.2, 0.6), (0.4, 0.4))


def write_photographs(folder, channel=0, tilts=TILTS):
    """One picture per tilt (about x and y, radians); the laser's light is in this channel."""
    for number, (down, across) in enumerate(tilts):
        pose = geometry.rigid_from_vectors(np.array([np.pi + down, across, 0.05]), np.array([0.005, 0.0, 0.4]))
        Image.fromarray(_photograph(pose, channel, number)).save(folder / f"view{number}.png")


def _photograph(camera_from_board, channel, seed):
    fine = (np.arange(3) - 1) / 3
    row, column = (np.add.outer(np.arange(n), fine).ravel() for n in SIZE)
    rays = np.stack(np.broadcast_arrays(column[None], row[:, None], 1.0), axis=-1) @ np.linalg.inv(MATRIX).T
    normal, origin = camera_from_board[:3, 2], camera_from_board[:3, 3]
    points = rays * (normal @ origin / (rays @ normal))[..., None]
    x, y = np.moveaxis((points - origin) @ camera_from_board[:3, :2] / SQUARE_M, -1, 0)
    x, y = x + (COLUMNS + 1) / 2, y + (ROWS + 1) / 2
    squares = (x > 0) & (x < COLUMNS + 1) & (y > 0) & (y < ROWS + 1)
    paper = np.where(squares & ((np.floor(x) + np.floor(y)) % 2 > 0), 20.0, 140.0)
    picture = np.repeat(paper[..., None], 3, axis=2)
    picture[..., channel] += 90.0 * np.exp(-0.5 * ((points @ NORMAL - OFFSET_M) / 0.0015) ** 2)
    picture = picture.reshape(SIZE[0], 3, SIZE[1], 3, 3).mean(axis=(1, 3))
    noise = np.random.default_rng(seed).normal(0.0, 1.0, picture.shape)
    return np.clip(np.rint(picture + noise), 0, 255).astype(np.uint8)
