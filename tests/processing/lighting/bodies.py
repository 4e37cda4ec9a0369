"""Bodies of triangles that tests trace rays against."""

import numpy as np


def sphere(rows, radius=1.0):
    """Vertices (n, 3) and triangles (m, 3) of a ball, counterclockwise from outside."""
    polar, azimuth = np.pi * np.arange(1, rows) / rows, 2 * np.pi * np.arange(2 * rows) / (2 * rows)
    ring = np.stack([np.cos(azimuth), np.sin(azimuth), np.ones_like(azimuth)], axis=-1)
    scale = np.stack([np.sin(polar), np.sin(polar), np.cos(polar)], axis=-1)
    vertices = np.concatenate([(scale[:, None] * ring).reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]])
    top, bottom, n = len(vertices) - 2, len(vertices) - 1, 2 * rows
    k, after = np.arange(n), (np.arange(n) + 1) % n
    last = (rows - 2) * n
    triangles = [np.stack([np.full(n, top), k, after], 1), np.stack([np.full(n, bottom), last + after, last + k], 1)]
    for row in range(rows - 2):
        a, b = row * n + k, row * n + after
        triangles += [np.stack([a, a + n, b], 1), np.stack([b, a + n, b + n], 1)]
    return radius * vertices, np.concatenate(triangles).astype(np.int32)


def box(low=(-0.5, -0.5, -0.5), high=(0.5, 0.5, 0.5)):
    """Vertices (8, 3) and triangles (12, 3) of a box, counterclockwise from outside."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return np.asarray(low) + corners * (np.asarray(high) - np.asarray(low)), np.array(triangles, np.int32)


def square(side=2.0):
    """An open floor: one square that faces up."""
    corners = side / 2 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32)
