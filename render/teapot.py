"""A teapot of our own outlines: a turned body with its lid, a spout and a handle, each a closed surface."""

from collections.abc import Callable

import numpy as np
from scipy.interpolate import CubicSpline

from render.arrays import Float64, Rows
from render.mesh import Mesh, Surface, grid_mesh
from render.shapes import joined, revolved, smooth_outline

# Radius and height from the middle of the foot up the belly, over the rim and the lid to the top of the knob.
_BODY_OUTLINE = np.array(
    [
        [0.0, 0.03], [0.30, 0.03], [0.50, 0.015], [0.57, 0.0], [0.61, 0.02], [0.625, 0.06], [0.70, 0.14], [0.88, 0.34],
        [0.98, 0.60], [0.96, 0.86], [0.82, 1.08], [0.66, 1.20], [0.62, 1.235], [0.585, 1.245], [0.56, 1.235],
        [0.545, 1.24], [0.50, 1.275], [0.34, 1.36], [0.15, 1.42], [0.085, 1.46], [0.09, 1.51], [0.145, 1.575],
        [0.15, 1.64], [0.09, 1.70], [0.0, 1.715],
    ]
)  # fmt: skip

# The middles of spout and handle (x, z), from inside the body outward, and back into it.
_SPOUT_MIDDLE = np.array([[0.62, 0.46], [1.02, 0.56], [1.32, 0.84], [1.48, 1.14], [1.68, 1.36]])
_HANDLE_MIDDLE = np.array(
    [[-0.60, 0.98], [-1.02, 1.06], [-1.40, 1.04], [-1.63, 0.82], [-1.52, 0.52], [-1.18, 0.34], [-0.70, 0.30]]
)

# Radius and share of the middle's length; the spout's goes over its lip and down inside.
_SPOUT_OUTLINE = np.array(
    [
        [0.0, 0.0], [0.22, 0.0], [0.28, 0.03], [0.27, 0.15], [0.215, 0.35], [0.155, 0.60], [0.125, 0.85], [0.13, 0.95],
        [0.13, 0.985], [0.112, 1.0], [0.095, 0.985], [0.09, 0.95], [0.085, 0.86], [0.05, 0.84], [0.0, 0.84],
    ]
)  # fmt: skip
_HANDLE_OUTLINE = np.array(
    [
        [0.0, 0.0], [0.06, 0.0], [0.095, 0.02], [0.09, 0.12], [0.08, 0.30], [0.075, 0.50], [0.08, 0.70], [0.09, 0.88],
        [0.095, 0.98], [0.06, 1.0], [0.0, 1.0],
    ]
)  # fmt: skip
_HANDLE_WIDTH = 1.5  # of its height

_INSIDE_ROWS = 2  # of the vertices of spout and handle, at each end that the body hides
_STEP = 1e-5

Tube = Callable[[Rows, Rows], Float64]


def teapot(detail: float = 1.0) -> Mesh:
    """A teapot 1.7 high on z = 0, its spout toward +X: 8000 vertices, `detail` times as fine along each side.

    Body, spout and handle are each closed; a row of the latter's vertices lies where they leave the body.
    """
    outline = smooth_outline(_BODY_OUTLINE)
    spout = _swept(_SPOUT_MIDDLE, smooth_outline(_SPOUT_OUTLINE), 1.0)
    handle = _swept(_HANDLE_MIDDLE, smooth_outline(_HANDLE_OUTLINE), _HANDLE_WIDTH)
    body_shape, spout_shape, handle_shape = (_finer(shape, detail) for shape in ((72, 64), (48, 32), (52, 24)))
    return joined(
        [
            grid_mesh(revolved(outline), body_shape, (4.0, 2.0)),
            grid_mesh(_tube_surface(spout, outline, spout_shape[0], ends=1), spout_shape, (1.0, 1.0)),
            grid_mesh(_tube_surface(handle, outline, handle_shape[0], ends=2), handle_shape, (1.0, 2.0)),
        ]
    )


def _finer(shape: tuple[int, int], detail: float) -> tuple[int, int]:
    return max(round(detail * shape[0]), 16), max(round(detail * shape[1]), 8)


def _swept(middle: Rows, outline: CubicSpline, width: float) -> Tube:
    """Points of a tube along a curve in the plane y = 0, from u around and places on its outline; wider along y."""
    curve = smooth_outline(middle)

    def tube(u: Rows, place: Rows) -> Float64:
        radius, share = outline(place).T
        centre, along = curve(share), curve(share, 1)
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        up, across = radius * np.cos(2 * np.pi * u), width * radius * np.sin(2 * np.pi * u)
        return np.column_stack([centre[:, 0] - up * along[:, 1], across, centre[:, 1] + up * along[:, 0]])

    return tube


def _tube_surface(tube: Tube, body: CubicSpline, rows: int, ends: int) -> Surface:
    """The tube, its rows spread so that the third, and with two ends the last but two, lie on the body's outside."""
    columns = np.linspace(0.0, 1.0, 129)
    leaves = [_crossings(tube, body, columns, last=bool(end)) for end in range(ends)]
    hidden = _INSIDE_ROWS / rows
    bounds = np.array([0.0, hidden, *([1.0 - hidden] if ends == 2 else []), 1.0])

    def surface(u: Rows, v: Rows) -> tuple[Rows, Rows, Rows]:
        places = np.stack([0 * u, *(np.interp(u, columns, crossing) for crossing in leaves), 0 * u + 1], axis=1)
        part = np.clip(np.searchsorted(bounds, v, side="right") - 1, 0, len(bounds) - 2)
        share = (v - bounds[part]) / (bounds[part + 1] - bounds[part])
        row = np.arange(len(u))
        place = (1 - share) * places[row, part] + share * places[row, part + 1]
        inner = np.clip(place, 1e-3, 1.0 - 1e-3)  # at the poles nothing goes around
        across = tube(u + _STEP, inner) - tube(u - _STEP, inner)
        down = tube(u, inner + _STEP) - tube(u, inner - _STEP)
        return tube(u, place), np.cross(down, across), across

    return surface


def _crossings(tube: Tube, body: CubicSpline, columns: Rows, *, last: bool) -> Float64:
    """Places (n,) on the tube's outline where each column first leaves the body, or comes back into it at the last."""
    radius, height = body(np.linspace(0.0, 1.0, 2001)).T
    places = np.linspace(0.0, 1.0, 801)[:: -1 if last else 1]
    u, place = (grid.ravel() for grid in np.meshgrid(columns, places, indexing="ij"))
    x, y, z = tube(u, place).T
    outside = np.hypot(x, y) - np.interp(z, np.maximum.accumulate(height), radius)
    found = (outside.reshape(len(columns), -1) > 0).argmax(axis=1)
    return np.asarray(places[found])
