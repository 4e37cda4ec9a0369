"""The furnished room under light: environments, materials, poses, eye.

The ground is lit in all environments: the floor has to hide it.
"""

import numpy as np

from processing.lighting.brdfs import Brdf, blinn_phong, ggx, lambert, ward
from processing.lighting.relighting import Relighting
from processing.products.arrays import Float64
from processing.products.light_environment import Environment, cube_directions
from tests.benchmarks.yardsticks.furniture import Piece

_GROUND = 0.4

EYE_M = np.array([2.6, -2.9, 1.9])


def sky(sun: float = 0.0) -> Environment:
    """A blue sky; the sun, a texel of 1.4 deg, sheds about as many times the sky's light."""
    size = 64
    toward = cube_directions(size)
    up = toward[..., 2:]
    radiance = np.where(up > 0, np.array([0.5, 0.7, 1.0]) * (1.2 - 0.7 * up), _GROUND)
    place = np.unravel_index((toward @ np.array([0.4, 0.3, 0.87])).argmax(), toward.shape[:3])
    radiance[place] += sun * radiance.mean() * 6 * size**2 / 2
    return Environment(radiance.astype(np.float32))


def windows() -> Environment:
    """A dim room with three windows and a lamp, of 10 to 40 deg each."""
    toward = cube_directions(64)
    radiance = np.broadcast_to(np.array([0.12, 0.11, 0.1]), toward.shape).copy()
    for way, half_deg, colour in (
        ((1, 0.3, 0.5), 18, (4, 4.5, 5)), ((-0.2, 1, 0.4), 20, (3, 3.4, 4)),
        ((-1, -0.6, 0.8), 14, (5, 5, 5)), ((0.2, -0.2, 1), 6, (20, 16, 11)),
    ):  # fmt: skip
        along = toward @ (np.array(way) / np.linalg.norm(way))
        radiance[along > np.cos(np.deg2rad(half_deg))] += np.array(colour)
    radiance[toward[..., 2] <= 0] = _GROUND
    return Environment(radiance.astype(np.float32))


def materials(pieces: tuple[Piece, ...], *, glossy: bool) -> dict[str, Brdf]:
    """A reflectance for each piece; glossy ones on table, chairs and lamp."""
    cloth, wood = lambert(np.array([0.5, 0.3, 0.25])), np.array([0.45, 0.3, 0.18])
    white = lambert(np.full(3, 0.7))
    if not glossy:
        return {piece.name: white for piece in pieces}
    chair = blinn_phong(wood, np.full(3, 0.2), 30.0)
    return {
        "floor": white,
        "table": ggx(wood, np.full(3, 0.05), 0.3),
        "chair": chair,
        "second chair": chair,
        "sofa": cloth,
        "lamp": ward(np.full(3, 0.2), np.full(3, 0.5), (0.2, 0.2)),
    }


def poses(pieces: tuple[Piece, ...]) -> list[Float64]:
    """Where the pieces stand."""
    found = [np.eye(4) for _ in pieces]
    for pose, piece in zip(found, pieces, strict=True):
        pose[:3, 3] = piece.place
    return found


def furnish(scene: Relighting, pieces: tuple[Piece, ...], *, glossy: bool) -> None:
    """Put all pieces in place, painted, before the eye."""
    painted = materials(pieces, glossy=glossy)
    for number, (piece, pose) in enumerate(zip(pieces, poses(pieces), strict=True)):
        scene.move(number, pose)
        scene.paint(number, painted[piece.name])
    scene.look_from(EYE_M)
