"""Meshes that need no file: sphere, plane, torus, a turned vase and a statue, with the frames of the smooth surface."""

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from render.arrays import Float64, Rows
from render.mesh import Mesh, grid_mesh

# A camera at azimuth 0 that looks along -X: x = +Y, y = -Z, z = -X of the rig frame.
MAP_FROM_RIG = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])

# Radius and height along the vase's outline, from the middle of its foot up the outside, over the lip, down inside.
_VASE_OUTLINE = np.array(
    [
        [0.0, 0.0], [0.30, 0.0], [0.36, 0.025], [0.34, 0.07], [0.40, 0.20], [0.56, 0.50], [0.62, 0.78], [0.55, 1.06],
        [0.36, 1.32], [0.25, 1.52], [0.24, 1.68], [0.31, 1.84], [0.37, 1.90], [0.36, 1.925], [0.31, 1.89],
        [0.20, 1.68], [0.21, 1.50], [0.32, 1.28], [0.50, 1.02], [0.56, 0.76], [0.50, 0.48], [0.30, 0.15], [0.0, 0.08],
    ]
)  # fmt: skip

# The same of the statue, from the crown of its head down to the middle of its foot.
_STATUE_OUTLINE = np.array(
    [
        [0.0, 2.46], [0.12, 2.42], [0.185, 2.28], [0.165, 2.10], [0.105, 1.99], [0.13, 1.90], [0.34, 1.82],
        [0.41, 1.66], [0.36, 1.44], [0.29, 1.24], [0.38, 1.00], [0.43, 0.82], [0.39, 0.60], [0.36, 0.34], [0.43, 0.07],
        [0.41, 0.0], [0.0, 0.0],
    ]
)  # fmt: skip


def sphere(radius: float = 1.0, *, tiles: tuple[float, float] = (4.0, 2.0), shape: tuple[int, int] = (64, 128)) -> Mesh:
    """A sphere about the origin, poles on Z; the texture goes around it `tiles[0]` times from +X toward +Y."""

    def surface(u: Rows, v: Rows) -> tuple[Rows, Rows, Rows]:
        normal = _turned(u, np.sin(np.pi * v), np.cos(np.pi * v))
        return radius * normal, normal, _around(u)

    return grid_mesh(surface, shape, tiles)


def captured_sphere(
    radius: float = 1.0, *, map_from_world: Rows = MAP_FROM_RIG, shape: tuple[int, int] = (64, 128)
) -> Mesh:
    """The sphere that a reflectance map was taken from, which finds its texel by the normal.

    `map_from_world` (3, 3) turns world directions into the frame of the capture's camera (x right, y down, z forward);
    as it stands, the world is the rig's frame, and azimuth 0 shows what that camera saw.
    """
    return replace(sphere(radius, shape=shape), map_from_world=np.asarray(map_from_world, dtype=np.float64))


def plane(side: float = 2.0, *, tiles: tuple[float, float] = (1.0, 1.0), shape: tuple[int, int] = (1, 1)) -> Mesh:
    """A square in z = 0 facing +Z, texture upright for who looks along -Z with +Y upward."""

    def surface(u: Rows, v: Rows) -> tuple[Rows, Rows, Rows]:
        positions = side * np.column_stack([u - 0.5, 0.5 - v, np.zeros_like(u)])
        ones, zeros = np.ones_like(u), np.zeros_like(u)
        return positions, np.column_stack([zeros, zeros, ones]), np.column_stack([ones, zeros, zeros])

    return grid_mesh(surface, shape, tiles)


def torus(
    radius: float = 1.0,
    tube_radius: float = 0.42,
    *,
    tiles: tuple[float, float] = (6.0, 2.0),
    shape: tuple[int, int] = (48, 120),
) -> Mesh:
    """A torus about the Z axis; the texture repeats `tiles` times around the axis and around the tube."""

    def surface(u: Rows, v: Rows) -> tuple[Rows, Rows, Rows]:
        # Texture rows run downward on the outside, so the tube is walked clockwise.
        angle_rad = np.pi - 2.0 * np.pi * v
        normal = _turned(u, np.cos(angle_rad), np.sin(angle_rad))
        return tube_radius * normal + _turned(u, radius, 0.0), normal, _around(u)

    return grid_mesh(surface, shape, tiles)


def vase(*, tiles: tuple[float, float] = (4.0, 4.0), shape: tuple[int, int] = (112, 112)) -> Mesh:
    """A vase turned about the Z axis, standing on z = 0, with a wall: closed, 25 000 triangles."""
    outline = _smooth(_VASE_OUTLINE)

    def surface(u: Rows, v: Rows) -> tuple[Rows, Rows, Rows]:
        # Texture rows run downward: v = 0 is the end of the outline, inside.
        radius, height = outline(1.0 - v).T
        slope_radius, slope_height = outline(1.0 - v, 1).T
        return _turned(u, radius, height), _turned(u, slope_height, -slope_radius), _around(u)

    return grid_mesh(surface, shape, tiles)


def statue(*, tiles: tuple[float, float] = (4.0, 8.0), shape: tuple[int, int] = (348, 122)) -> Mesh:
    """A draped figure on z = 0, 2.46 high: of no symmetry, with folds; closed, 84 668 triangles as it stands.

    As many as a common scan of the Venus has. Normals and tangents are differences of the surface over 1e-5 of its
    length, right to about 1e-9.
    """
    outline, step = _smooth(_STATUE_OUTLINE), 1e-5

    def surface(u: Rows, v: Rows) -> tuple[Rows, Rows, Rows]:
        inside = np.clip(v, 1e-3, 1.0 - 1e-3)  # at the poles nothing goes around
        across = _draped(outline, u + step, inside) - _draped(outline, u - step, inside)
        down = _draped(outline, u, inside + step) - _draped(outline, u, inside - step)
        return _draped(outline, u, v), np.cross(down, across), across

    return grid_mesh(surface, shape, tiles)


def _draped(outline: CubicSpline, u: Rows, v: Rows) -> Float64:
    """Points of the statue: an outline turned about a bent axis, flattened, turned in itself, with folds below."""
    radius, height = outline(v).T
    around = 2.0 * np.pi * u
    skirt = 1.0 / (1.0 + np.exp(9.0 * (height - 0.95)))
    folds = 0.07 * np.sin(9.0 * around + 5.0 * height) + 0.04 * np.sin(14.0 * around - 7.0 * height)
    chest = 0.16 * np.exp(-(((height - 1.62) / 0.13) ** 2)) * np.cos(2.0 * (around - 0.5 * np.pi))
    face = 0.10 * np.exp(-(((height - 2.22) / 0.08) ** 2)) * np.exp(4.0 * (np.cos(around + 1.2) - 1.0))
    radius = radius * (1.0 + skirt * folds + chest + face)
    turned = around + 0.5 * np.sin(1.3 * height)
    bent = 0.09 * np.sin(2.6 * height)
    return np.column_stack([radius * np.cos(turned) + bent, 0.72 * radius * np.sin(turned), height])


def _smooth(outline: Rows) -> CubicSpline:
    """The spline through an outline (n, 2) over [0, 1], its corners spread by the roots of their distances."""
    chord = np.linalg.norm(np.diff(outline, axis=0), axis=1)
    length = np.concatenate([[0.0], np.cumsum(np.sqrt(chord))])
    return CubicSpline(length / length[-1], outline)


def _turned(u: Rows, radius: Rows | float, height: Rows | float) -> Float64:
    """Points at a radius and height, turned about Z by the share u of a full turn."""
    angle_rad = 2.0 * np.pi * u
    height = np.broadcast_to(np.asarray(height, dtype=np.float64), u.shape)
    return np.column_stack([radius * np.cos(angle_rad), radius * np.sin(angle_rad), height])


def _around(u: Rows) -> Float64:
    """The direction in which `_turned` moves for growing u."""
    angle_rad = 2.0 * np.pi * u
    return np.column_stack([-np.sin(angle_rad), np.cos(angle_rad), np.zeros_like(u)])
