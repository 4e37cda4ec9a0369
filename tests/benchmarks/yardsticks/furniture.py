"""A furnished room: two chairs with slats, a table, a sofa, a lamp and a floor, as fine as one asks for."""

import atexit
import tempfile
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np

from processing.lighting.cuts import Cuts
from processing.lighting.directions import sample_directions
from processing.lighting.field import VisibilityField
from processing.lighting.outline import FlatOutline, flat_outline
from processing.lighting.precomputation import Cost, cached_field, cached_self_visibility
from processing.lighting.shells import ShellPlan
from processing.lighting.triangle_body import TriangleBody, triangle_body
from processing.products.arrays import Float64, Int32

FULL, QUICK = 27_000, 2_000  # vertices; the first is the paper's
ROOM_M = 4.0
PLACES_M = {
    "floor": (0.0, 0.0, 0.0),
    "table": (0.0, 0.2, 0.0),
    "chair": (-0.15, 0.95, 0.0),
    "second chair": (0.85, 0.1, 0.0),
    "sofa": (-0.2, -1.3, 0.0),
    "lamp": (1.4, -1.35, 0.0),
}
_FLOOR_SHARE = 0.3  # of the vertices: shadows fall on it
_CLEARANCE_M = 1e-3  # between feet and floor

Part = tuple[Float64, Float64, Int32]


@dataclass(frozen=True, eq=False)
class Piece:
    """A piece of furniture in its own frame, z upward from the floor, in metres; it stands at `place`.

    The floor is flat: its outline tells what it hides.
    """

    name: str
    body: TriangleBody
    place: Float64

    @cached_property
    def outline(self) -> FlatOutline | None:
        """What a flat piece needs in place of a field."""
        return flat_outline(self.body)


@dataclass(frozen=True, eq=False)
class PrecomputedPiece:
    """A piece with its cuts, its field and what they cost; pieces of one shape share them."""

    piece: Piece
    self_visibility: Cuts
    cuts_cost: Cost
    field: VisibilityField | FlatOutline
    field_cost: Cost | None


@lru_cache(maxsize=4)
def furniture(vertices: int) -> tuple[Piece, ...]:
    """The room with about as many vertices; edges are as long everywhere, but for the floor's."""
    shapes = {"table": _table, "chair": _chair, "sofa": _sofa, "lamp": _lamp}
    copies = {"table": 1, "chair": 2, "sofa": 1, "lamp": 1}
    fine, coarse = 0.002, 2.0
    for _ in range(40):
        edge = np.sqrt(fine * coarse)
        count = sum(copies[name] * len(shape(edge)[0]) for name, shape in shapes.items())
        fine, coarse = (edge, coarse) if count > (1 - _FLOOR_SHARE) * vertices else (fine, edge)
    bodies = {name: _body(shape(coarse)) for name, shape in shapes.items()}
    bodies["second chair"] = bodies["chair"]
    side = max(round(np.sqrt(_FLOOR_SHARE * vertices)) - 1, 1)
    bodies["floor"] = _body(_rectangle(np.array([ROOM_M, 0, 0]), np.array([0, ROOM_M, 0]), (side, side)))
    lift = {name: np.array([0, 0, 0.0 if name == "floor" else _CLEARANCE_M]) for name in PLACES_M}
    return tuple(Piece(name, bodies[name], np.array(place) + lift[name]) for name, place in PLACES_M.items())


@lru_cache(maxsize=2)
def precomputed_furniture(vertices: int, plan: ShellPlan) -> tuple[PrecomputedPiece, ...]:
    """The room with its cuts and fields, computed once in a run."""
    return tuple(_precomputed(piece, plan) for piece in furniture(vertices))


@cache
def scratch() -> Path:
    """A folder of this run for what is kept by content."""
    folder = tempfile.TemporaryDirectory(prefix="relight-")
    atexit.register(folder.cleanup)
    return Path(folder.name)


def _precomputed(piece: Piece, plan: ShellPlan) -> PrecomputedPiece:
    sampled = sample_directions()
    cuts, cuts_cost = cached_self_visibility(piece.body, sampled, scratch())
    if piece.outline is not None:
        return PrecomputedPiece(piece, cuts, cuts_cost, piece.outline, None)
    return PrecomputedPiece(piece, cuts, cuts_cost, *cached_field(piece.body, sampled, scratch(), shells=plan))


def _body(part: Part) -> TriangleBody:
    vertices, normals, triangles = part
    return triangle_body(vertices, triangles, normals)


def _chair(edge: float) -> Part:
    legs = [_box((x, y, h / 2), (0.04, 0.04, h), edge) for x in (-0.2, 0.2) for y, h in ((-0.2, 0.43), (0.2, 0.9))]
    slats = [_box((0, 0.2, z), (0.36, 0.015, 0.04), edge) for z in np.arange(0.53, 0.89, 0.07)]
    rails = [_box((x, 0, 0.2), (0.02, 0.36, 0.03), edge) for x in (-0.2, 0.2)]
    return _joined([*legs, *slats, *rails, _box((0, 0, 0.445), (0.44, 0.44, 0.03), edge)])


def _table(edge: float) -> Part:
    legs = [_box((x, y, 0.345), (0.06, 0.06, 0.69), edge) for x in (-0.5, 0.5) for y in (-0.3, 0.3)]
    aprons = [_box((0, y, 0.65), (0.94, 0.02, 0.08), edge) for y in (-0.3, 0.3)]
    return _joined([*legs, *aprons, _box((0, 0, 0.71), (1.2, 0.8, 0.04), edge)])


def _sofa(edge: float) -> Part:
    arms = [_box((x, 0, 0.25), (0.2, 0.8, 0.5), edge) for x in (-0.8, 0.8)]
    rolls = [
        _tube([(-0.4, 0.0), (-0.4, 0.12), (0.4, 0.12), (0.4, 0.0)], (x, 0, 0.5), edge, along=1) for x in (-0.8, 0.8)
    ]
    cushions = [_box((x, 0.06, 0.34), (0.68, 0.62, 0.14), edge) for x in (-0.35, 0.35)]
    back = _box((0, -0.32, 0.45), (1.4, 0.16, 0.8), edge)
    return _joined([*arms, *rolls, *cushions, back, _box((0, 0, 0.16), (1.4, 0.76, 0.2), edge)])


def _lamp(edge: float) -> Part:
    foot = _tube([(0.0, 0.0), (0.0, 0.16), (0.03, 0.16), (0.05, 0.015), (1.3, 0.015), (1.3, 0.0)], (0, 0, 0), edge)
    shade = _tube([(1.2, 0.22), (1.5, 0.12)], (0, 0, 0), edge)
    return _joined([foot, shade])


def _box(centre: tuple[float, ...], size: tuple[float, ...], edge: float) -> Part:
    """Six faces with vertices of their own."""
    faces = []
    for axis in range(3):
        for side in (1, -1):
            across = np.zeros((2, 3))
            across[0, (axis + 1) % 3], across[1, (axis + 2) % 3] = size[(axis + 1) % 3], size[(axis + 2) % 3]
            one, two = across[::side]
            steps = tuple(max(round(np.linalg.norm(way) / edge), 1) for way in (one, two))
            vertices, normals, triangles = _rectangle(one, two, steps)
            middle = np.array(centre, float)
            middle[axis] += side * size[axis] / 2
            faces.append((vertices + middle, normals, triangles))
    return _joined(faces)


def _rectangle(one: Float64, two: Float64, steps: tuple[int, int]) -> Part:
    """A rectangle around the origin between two edges, which faces along their cross product."""
    u, v = (np.arange(count + 1) / count - 0.5 for count in steps)
    vertices = u[:, None, None] * one + v[None, :, None] * two
    normal = np.cross(one, two)
    normals = np.broadcast_to(normal / np.linalg.norm(normal), vertices.shape)
    return vertices.reshape(-1, 3), normals.reshape(-1, 3), _quads(*steps)


def _tube(profile: list[tuple[float, float]], centre: tuple[float, ...], edge: float, along: int = 2) -> Part:
    """Bands around an axis between points (place along it, radius); it faces outward where the profile ascends."""
    bands = []
    for (low, first), (high, second) in pairwise(profile):
        around = max(round(2 * np.pi * max(first, second) / edge), 8)
        up = max(round(np.hypot(high - low, second - first) / edge), 1)
        share, angle = np.meshgrid(np.arange(up + 1) / up, 2 * np.pi * np.arange(around + 1) / around, indexing="ij")
        radius, place = first + share * (second - first), low + share * (high - low)
        slope = np.array([high - low, first - second]) / np.hypot(high - low, second - first)
        level = (np.cos(angle), np.sin(angle))
        vertices = np.stack([radius * level[0], radius * level[1], place], axis=-1)
        normals = np.stack([slope[0] * level[0], slope[0] * level[1], np.full_like(angle, slope[1])], axis=-1)
        order = [(k - along + 2) % 3 for k in range(3)]
        triangles = _quads(up, around)[:, ::-1]
        bands.append((vertices.reshape(-1, 3)[:, order] + centre, normals.reshape(-1, 3)[:, order], triangles))
    return _joined(bands)


def _quads(rows: int, columns: int) -> Int32:
    """Triangles over a grid of (rows + 1) x (columns + 1) vertices."""
    corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    below = corner + columns + 1
    quads = [np.stack([corner, below, below + 1], 1), np.stack([corner, below + 1, corner + 1], 1)]
    return np.concatenate(quads).astype(np.int32)


def _joined(parts: list[Part]) -> Part:
    shift = np.cumsum([0, *(len(vertices) for vertices, _, _ in parts)])
    triangles = [part[2] + first for part, first in zip(parts, shift, strict=False)]
    return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts]), np.concatenate(triangles)
