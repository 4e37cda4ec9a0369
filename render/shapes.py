"""Meshes without a file: sphere, plane, box, torus, cylinder, knot, vase, statue, with frames of the smooth surface.

Those whose `_surface` is public can be had as the smooth surface itself, to move it or to put something else on it.
"""

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from render.arrays import Float64, Rows, unit
from render.mesh import Mesh, Surface, grid_mesh

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
    return grid_mesh(sphere_surface(radius), shape, tiles)


def sphere_surface(radius: float = 1.0) -> Surface:
    """The surface of `sphere`."""

    def surface(u: Rows, v: Rows) -> tuple[Rows, Rows, Rows]:
        normal = _turned(u, np.sin(np.pi * v), np.cos(np.pi * v))
        return radius * normal, normal, _around(u)

    return surface


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
    return grid_mesh(plane_surface(side), shape, tiles)


def plane_surface(side: float = 2.0) -> Surface:
    """The surface of `plane`."""

    def surface(u: Rows, v: Rows) -> tuple[Rows, Rows, Rows]:
        positions = side * np.column_stack([u - 0.5, 0.5 - v, np.zeros_like(u)])
        ones, zeros = np.ones_like(u), np.zeros_like(u)
        return positions, np.column_stack([zeros, zeros, ones]), np.column_stack([ones, zeros, zeros])

    return surface


def box() -> Mesh:
    """A cube of side 1 about the origin; each face has vertices of its own and shows the texture once."""
    faces = []
    for axis in range(3):
        for side in (1.0, -1.0):
            normal, along = np.zeros(3), np.zeros(3)
            normal[axis], along[(axis + 1) % 3] = side, side
            pose = np.eye(4)
            pose[:3] = np.column_stack([along, np.cross(normal, along), normal, 0.5 * normal])
            faces.append(grid_mesh(placed(plane_surface(1.0), pose), (1, 1), (1.0, 1.0)))
    return joined(faces)


def torus(
    radius: float = 1.0,
    tube_radius: float = 0.42,
    *,
    tiles: tuple[float, float] = (6.0, 2.0),
    shape: tuple[int, int] = (48, 120),
) -> Mesh:
    """A torus about the Z axis; the texture repeats `tiles` times around the axis and around the tube."""
    return grid_mesh(torus_surface(radius, tube_radius), shape, tiles)


def torus_surface(radius: float = 1.0, tube_radius: float = 0.42) -> Surface:
    """The surface of `torus`."""

    def surface(u: Rows, v: Rows) -> tuple[Rows, Rows, Rows]:
        # Texture rows run downward on the outside, so the tube is walked clockwise.
        angle_rad = np.pi - 2.0 * np.pi * v
        normal = _turned(u, np.cos(angle_rad), np.sin(angle_rad))
        return tube_radius * normal + _turned(u, radius, 0.0), normal, _around(u)

    return surface


def cylinder(
    radius: float = 0.5,
    height: float = 2.0,
    *,
    tiles: tuple[float, float] = (6.0, 4.0),
    shape: tuple[int, int] = (32, 96),
) -> Mesh:
    """A closed cylinder about the Z axis, its middle in the origin; the texture repeats `tiles` times around and along.

    The ends are flat discs whose texture lies straight, at the same length of a tile as on the side.
    """
    side = grid_mesh(cylinder_surface(radius, height), shape, tiles)
    tile = np.array([2.0 * np.pi * radius / tiles[0], height / tiles[1]])
    rings = max(1, round(shape[1] / 12))
    ends = [_disc(radius, facing * 0.5 * height, facing, (rings, shape[1]), tile) for facing in (1.0, -1.0)]
    return joined([side, *ends])


def cylinder_surface(radius: float = 0.5, height: float = 2.0) -> Surface:
    """The side of `cylinder`."""

    def surface(u: Rows, v: Rows) -> tuple[Rows, Rows, Rows]:
        return _turned(u, radius, (0.5 - v) * height), _turned(u, 1.0, 0.0), _around(u)

    return surface


def knot(
    radius: float = 1.0,
    coil_radius: float = 0.5,
    tube_radius: float = 0.22,
    *,
    turns: tuple[int, int] = (2, 3),
    tiles: tuple[float, float] = (24.0, 2.0),
    shape: tuple[int, int] = (24, 480),
) -> Mesh:
    """A tube along a torus knot; the texture repeats `tiles` times along the knot, evenly, and around the tube.

    The knot lies on a torus about the Z axis and goes `turns` times around that axis and around the torus's tube, of
    radius `coil_radius`; as it stands 23 040 triangles.
    """
    return grid_mesh(knot_surface(radius, coil_radius, tube_radius, turns=turns), shape, tiles)


def knot_surface(
    radius: float = 1.0, coil_radius: float = 0.5, tube_radius: float = 0.22, *, turns: tuple[int, int] = (2, 3)
) -> Surface:
    """The surface of `knot`: u by arc length, v around from a direction that is carried along without turning.

    What such a direction has turned when it comes back is spread over the whole length, so that the texture closes.
    Tangents are differences of the surface over 1e-5 of its length, right to about 1e-9. Source: Bishop, There is More
    than One Way to Frame a Curve, 1975.
    """
    step = 1e-5
    angle, twist = _even_angle_and_twist(radius, coil_radius, turns)

    def tube(u: Rows, v: Rows) -> tuple[Rows, Rows]:
        around = (twist(u % 1.0) + 2.0 * np.pi * v)[:, None]
        middle, along, out = _torus_knot(angle(u % 1.0), radius, coil_radius, turns)
        normal = np.cos(around) * out + np.sin(around) * np.cross(along, out)
        return middle + tube_radius * normal, normal

    def surface(u: Rows, v: Rows) -> tuple[Rows, Rows, Rows]:
        return *tube(u, v), tube(u + step, v)[0] - tube(u - step, v)[0]

    return surface


def placed(surface: Surface, world_from_body: Rows) -> Surface:
    """The surface moved by a rigid transform (4, 4)."""
    turn, shift = world_from_body[:3, :3], world_from_body[:3, 3]

    def moved(u: Rows, v: Rows) -> tuple[Rows, Rows, Rows]:
        positions, normals, tangents = surface(u, v)
        return positions @ turn.T + shift, normals @ turn.T, tangents @ turn.T

    return moved


def vase(*, tiles: tuple[float, float] = (4.0, 4.0), shape: tuple[int, int] = (112, 112)) -> Mesh:
    """A vase turned about the Z axis, standing on z = 0, with a wall: closed, 25 000 triangles."""
    return grid_mesh(revolved(smooth_outline(_VASE_OUTLINE)), shape, tiles)


def revolved(outline: CubicSpline) -> Surface:
    """The surface of an outline (radius, height) over [0, 1] turned about the Z axis, to the right of whose way is out.

    Texture rows run downward: v = 0 is the outline's end.
    """

    def surface(u: Rows, v: Rows) -> tuple[Rows, Rows, Rows]:
        radius, height = outline(1.0 - v).T
        slope_radius, slope_height = outline(1.0 - v, 1).T
        return _turned(u, radius, height), _turned(u, slope_height, -slope_radius), _around(u)

    return surface


def statue(*, tiles: tuple[float, float] = (4.0, 8.0), shape: tuple[int, int] = (348, 122)) -> Mesh:
    """A draped figure on z = 0, 2.46 high: of no symmetry, with folds; closed, 84 668 triangles as it stands.

    As many as a common scan of the Venus has. Normals and tangents are differences of the surface over 1e-5 of its
    length, right to about 1e-9.
    """
    return grid_mesh(statue_surface(), shape, tiles)


def statue_surface() -> Surface:
    """The surface of `statue`."""
    outline, step = smooth_outline(_STATUE_OUTLINE), 1e-5

    def surface(u: Rows, v: Rows) -> tuple[Rows, Rows, Rows]:
        inside = np.clip(v, 1e-3, 1.0 - 1e-3)  # at the poles nothing goes around
        across = _draped(outline, u + step, inside) - _draped(outline, u - step, inside)
        down = _draped(outline, u, inside + step) - _draped(outline, u, inside - step)
        return _draped(outline, u, v), np.cross(down, across), across

    return surface


def _disc(radius: float, height: float, facing: float, shape: tuple[int, int], tile: Rows) -> Mesh:
    """A disc across the Z axis that faces +Z or -Z, the texture's u along +X; `tile` (2,) is the length of one."""

    def surface(u: Rows, v: Rows) -> tuple[Rows, Rows, Rows]:
        # Rows run outward where the disc faces up, inward where it faces down: the triangles face as the disc does.
        positions = _turned(u, radius * (v if facing > 0 else 1.0 - v), height)
        normals, tangents = np.zeros_like(positions), np.zeros_like(positions)
        normals[:, 2], tangents[:, 0] = facing, 1.0
        return positions, normals, tangents

    mesh = grid_mesh(surface, shape, (1.0, 1.0))
    return replace(mesh, uv=mesh.positions[:, :2] * [1.0, -facing] / tile)


def joined(meshes: list[Mesh]) -> Mesh:
    """One mesh of several; nothing is welded."""
    first = np.cumsum([0, *(len(mesh.positions) for mesh in meshes)])
    triangles = np.concatenate([mesh.triangles + start for mesh, start in zip(meshes, first, strict=False)])
    positions, normals, tangents, uv = (
        np.concatenate([getattr(mesh, name) for mesh in meshes]) for name in ("positions", "normals", "tangents", "uv")
    )
    return Mesh(positions, normals, tangents, uv, triangles.astype(np.int32))


def _torus_knot(
    angle_rad: Rows, radius: float, coil_radius: float, turns: tuple[int, int]
) -> tuple[Float64, Float64, Float64]:
    """Points of a torus knot over [0, 2 pi], unit vectors along it, and normals of the torus that it lies on."""
    around, coiled = turns[0] * angle_rad / (2.0 * np.pi), turns[1] * angle_rad
    normal = _turned(around, np.cos(coiled), np.sin(coiled))
    reach = radius + coil_radius * np.cos(coiled)
    across = _turned(around, -np.sin(coiled), np.cos(coiled))
    along = turns[0] * reach[:, None] * _around(around) + turns[1] * coil_radius * across
    return _turned(around, radius, 0.0) + coil_radius * normal, unit(along), normal


def _even_angle_and_twist(radius: float, coil_radius: float, turns: tuple[int, int]) -> tuple[CubicSpline, CubicSpline]:
    """The knot's angle, and how far a carried direction stands from the torus's normal, over the share of length."""
    angle = np.linspace(0.0, 2.0 * np.pi, 2049)
    points, along, out = _torus_knot(angle, radius, coil_radius, turns)
    points[-1], along[-1], out[-1] = points[0], along[0], out[0]  # for the splines, equal to the last bit
    slope, turning = (CubicSpline(angle, rows, bc_type="periodic")(angle, 1) for rows in (points, out))
    length = CubicSpline(angle, np.linalg.norm(slope, axis=1)).antiderivative()(angle)
    share = length / length[-1]
    twist = CubicSpline(angle, -np.sum(turning * np.cross(along, out), axis=1)).antiderivative()(angle)
    closed = 2.0 * np.pi * np.round(twist[-1] / (2.0 * np.pi))
    return CubicSpline(share, angle), CubicSpline(share, twist + (closed - twist[-1]) * share)


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


def smooth_outline(outline: Rows) -> CubicSpline:
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
