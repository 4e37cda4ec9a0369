"""Meshes that need no file: sphere, plane, torus and a turned vase, all with analytic frames."""

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
    chord = np.linalg.norm(np.diff(_VASE_OUTLINE, axis=0), axis=1)
    length = np.concatenate([[0.0], np.cumsum(np.sqrt(chord))])
    outline = CubicSpline(length / length[-1], _VASE_OUTLINE)

    def surface(u: Rows, v: Rows) -> tuple[Rows, Rows, Rows]:
        # Texture rows run downward: v = 0 is the end of the outline, inside.
        radius, height = outline(1.0 - v).T
        slope_radius, slope_height = outline(1.0 - v, 1).T
        return _turned(u, radius, height), _turned(u, slope_height, -slope_radius), _around(u)

    return grid_mesh(surface, shape, tiles)


def _turned(u: Rows, radius: Rows | float, height: Rows | float) -> Float64:
    """Points at a radius and height, turned about Z by the share u of a full turn."""
    angle_rad = 2.0 * np.pi * u
    height = np.broadcast_to(np.asarray(height, dtype=np.float64), u.shape)
    return np.column_stack([radius * np.cos(angle_rad), radius * np.sin(angle_rad), height])


def _around(u: Rows) -> Float64:
    """The direction in which `_turned` moves for growing u."""
    angle_rad = 2.0 * np.pi * u
    return np.column_stack([-np.sin(angle_rad), np.cos(angle_rad), np.zeros_like(u)])
