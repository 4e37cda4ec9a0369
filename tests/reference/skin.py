"""Plain twins of the skin's kernels, and solids to lay skins on."""

from itertools import product

import numpy as np


def cheapest_closed_path(cost: np.ndarray, steepest: int) -> float:
    """Cost of the cheapest path through all rows whose columns differ by `steepest` at most, also last to first."""
    rows, columns = cost.shape
    totals = [
        sum(cost[row, column] for row, column in enumerate(path))
        for path in product(range(columns), repeat=rows)
        if all(abs(path[k] - path[k - 1]) <= steepest for k in range(rows))
    ]
    return min(totals)


def misfits(image: np.ndarray, piece: np.ndarray, mask: np.ndarray, wrap: bool) -> np.ndarray:
    """Sum of mask (piece - image)^2 at every offset at which the piece fits, by the definition."""
    height, width = image.shape[:2]
    size = len(piece)
    last = (height, width) if wrap else (height - size + 1, width - size + 1)
    errors = np.empty(last)
    for row, column in product(range(last[0]), range(last[1])):
        there = image[np.ix_((row + np.arange(size)) % height, (column + np.arange(size)) % width)]
        errors[row, column] = (mask[..., None] * (piece - there) ** 2).sum()
    return errors


def ball(rows: int = 12, columns: int = 24) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A closed unit sphere, poles on Z: positions, normals, triangles."""
    polar = np.pi * np.arange(1, rows) / rows
    azimuth = 2 * np.pi * np.arange(columns) / columns
    level = np.stack([np.outer(np.sin(polar), f(azimuth)) for f in (np.cos, np.sin)], axis=-1)
    ring = np.concatenate([level, np.broadcast_to(np.cos(polar)[:, None, None], (rows - 1, columns, 1))], axis=-1)
    positions = np.concatenate([ring.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]])
    here = np.arange(columns)
    following = np.roll(here, -1)
    top, bottom = (rows - 1) * columns, (rows - 1) * columns + 1
    triangles = [np.stack([np.full(columns, top), here, following], 1)]
    for row in range(rows - 2):
        a, b, c, d = (row * columns + here, (row + 1) * columns + here, (row + 1) * columns + following,
                      row * columns + following)  # fmt: skip
        triangles += [np.stack([a, b, c], 1), np.stack([a, c, d], 1)]
    last = (rows - 2) * columns
    triangles.append(np.stack([np.full(columns, bottom), last + following, last + here], 1))
    return positions, positions.copy(), np.concatenate(triangles).astype(np.int32)


def cylinder(rows: int = 10, columns: int = 48, height: float = 2.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """An open unit cylinder about Z: positions, normals, triangles."""
    azimuth, z = np.meshgrid(2 * np.pi * np.arange(columns) / columns, np.linspace(0, height, rows + 1))
    normals = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros_like(z)], axis=-1).reshape(-1, 3)
    positions = normals + np.outer(z.ravel(), [0, 0, 1])
    a = (np.arange(rows)[:, None] * columns + np.arange(columns)).ravel()
    b = (np.arange(rows)[:, None] * columns + (np.arange(columns) + 1) % columns).ravel()
    triangles = np.concatenate([np.stack([a, b, b + columns], 1), np.stack([a, b + columns, a + columns], 1)])
    return positions, normals, triangles.astype(np.int32)


def nearest_triangle(corner_uv: np.ndarray, place: np.ndarray) -> tuple[int, float]:
    """The triangle (of m, 3, 2) that contains a place, or else the one with the nearest side, and how far that is."""
    best, least = -1, np.inf
    for number, corners in enumerate(corner_uv):
        matrix = np.stack([corners[1] - corners[0], corners[2] - corners[0]], axis=1)
        second, third = np.linalg.solve(matrix, place - corners[0])
        if min(second, third, 1 - second - third) >= 0:
            return number, 0.0
        for start, end in ((0, 1), (1, 2), (2, 0)):
            side, to = corners[end] - corners[start], place - corners[start]
            far = np.linalg.norm(to - np.clip(to @ side / (side @ side), 0, 1) * side)
            if far < least:
                best, least = number, float(far)
    return best, least
