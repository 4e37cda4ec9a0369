"""Relit radiance of the furnished room against direct summation: all directions of all vertices traced.

`relative_rmse_vs_direct`: root mean square error over the mean of the truth, of vertices drawn from the whole room,
with fields of 32 spheres, the worse of Lambert and glossy materials, a room with windows; glossy ones of vertices that
face the eye, as no picture shows the others. `bias`: the mean error over the mean, its size. `near_contact_rmse`: the
same error of vertices closer than 15 cm to another body than the floor. `vcf_error_monotone`: 1 where the error falls
from each of 8, 16, 32, 64 spheres to the next. Rows have other lights, cuts' tolerances and spacings; `far_rmse` is of
the vertices that are near no other body.
"""

from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from processing.lighting.directions import sample_directions
from processing.lighting.light import EnvironmentLight
from processing.lighting.precomputation import TOLERANCE
from processing.lighting.relighting import Relighting
from processing.lighting.shells import ShellPlan
from processing.lighting.surroundings import RelitBody
from processing.products.arrays import Float64
from processing.products.light_environment import Environment
from service.bench import Result
from tests.benchmarks.yardsticks.furniture import FULL, QUICK, Piece, furniture
from tests.benchmarks.yardsticks.relit_furniture import EYE_M, furnish, materials, poses, sky, windows
from tests.benchmarks.yardsticks.sparse_fields import cuts_of, field_around
from tests.reference.relit import DirectLight, radiance_of

SEED = 1
RESOLUTIONS = 8, 16, 32, 64
USUAL = 32
NEAR_M = 0.15


class _Room:
    """Vertices drawn from the room, what is visible to them in truth, and fields around them."""

    def __init__(self, vertices: int, drawn: int, seed: int) -> None:
        self.pieces, self.sampled = furniture(vertices), sample_directions()
        self.first = np.cumsum([0, *(len(piece.body.vertices) for piece in self.pieces)])
        self.drawn = np.sort(np.random.default_rng(seed).choice(self.first[-1], drawn, replace=False))
        self.direct = DirectLight([piece.body for piece in self.pieces], poses(self.pieces), self.sampled)
        self.visible = [self.direct.visible_cos(vertex) for vertex in self.drawn]
        self.near = _near(self.pieces, self.first, self.drawn)
        self.counted = {False: np.ones(drawn, np.bool_), True: self._facing()}
        self._cuts = {}

    def relit(self, plan: ShellPlan, tolerance: float = TOLERANCE) -> list[RelitBody]:
        """The bodies with what the drawn vertices need."""
        found = []
        for number, piece in enumerate(self.pieces):
            own = self._own(number)
            if (number, tolerance) not in self._cuts:
                self._cuts[number, tolerance] = cuts_of(piece.body, self.sampled, own, tolerance)
            around = [
                other.body.origins[self._own(k)] + other.place - piece.place
                for k, other in enumerate(self.pieces)
                if k != number
            ]
            shells = plan.around(piece.body.centre, piece.body.radius)
            field = piece.outline or field_around(piece.body, self.sampled, shells, np.concatenate(around))
            found.append(RelitBody(piece.body, self._cuts[number, tolerance], field))
        return found

    def truth(self, environment: Environment, *, glossy: bool) -> Float64:
        light = EnvironmentLight(environment, self.sampled).turned(np.eye(3)).values
        painted = materials(self.pieces, glossy=glossy)
        found = []
        for visible, number, own in self.visible:
            piece = self.pieces[number]
            toward = EYE_M - piece.body.vertices[own] - piece.place
            toward /= np.linalg.norm(toward)
            normal = piece.body.normals[own]
            found.append(radiance_of(visible, light, self.sampled.directions, normal, toward, painted[piece.name]))
        return np.array(found)

    def _facing(self) -> np.ndarray:
        """Which of the drawn vertices face the eye."""
        points = np.concatenate([piece.body.vertices + piece.place for piece in self.pieces])[self.drawn]
        normals = np.concatenate([piece.body.normals for piece in self.pieces])[self.drawn]
        return ((EYE_M - points) * normals).sum(axis=1) > 0

    def found(self, bodies: list[RelitBody], environment: Environment, *, glossy: bool) -> Float64:
        scene = Relighting(bodies, self.sampled, environment)
        furnish(scene, self.pieces, glossy=glossy)
        return scene.frame(self.drawn).radiance.astype(np.float64)

    def _own(self, number: int) -> np.ndarray:
        own = self.drawn[(self.drawn >= self.first[number]) & (self.drawn < self.first[number + 1])]
        return own - self.first[number]


def _near(pieces: tuple[Piece, ...], first: np.ndarray, drawn: np.ndarray) -> np.ndarray:
    """Which of the drawn vertices are near a vertex of another body, the floor not counted."""
    points = np.concatenate([piece.body.vertices + piece.place for piece in pieces])
    body = np.searchsorted(first, drawn, side="right") - 1
    found = np.zeros(len(drawn), np.bool_)
    for number, piece in enumerate(pieces):
        if piece.outline is None:
            distance = cKDTree(piece.body.vertices + piece.place).query(points[drawn])[0]
            found |= (distance < NEAR_M) & (body != number)
    return found


def errors(room: _Room, found: Float64, truth: Float64, *, glossy: bool) -> dict[str, float]:
    """Relative root mean square error and bias over the mean of the truth, and the former near bodies and elsewhere."""
    some = room.counted[glossy]
    apart, mean = (found - truth)[some], truth[some].mean()
    return {
        "relative_rmse": _rmse_of(found, truth, some),
        "bias": float(apart.mean() / mean),
        "near_rmse": _rmse_of(found, truth, some & room.near),
        "far_rmse": _rmse_of(found, truth, some & ~room.near),
    }


def run(*, quick: bool) -> Result:
    """Of 600 of 27 000 vertices, or of 100 of 2000."""
    room = _Room(QUICK if quick else FULL, 100 if quick else 600, SEED)
    indoors, rows = windows(), []
    truths = {glossy: room.truth(indoors, glossy=glossy) for glossy in (False, True)}
    figures, by_resolution = {}, []
    for resolution in RESOLUTIONS:
        bodies = room.relit(ShellPlan(resolution))
        found = {
            glossy: errors(room, room.found(bodies, indoors, glossy=glossy), truths[glossy], glossy=glossy)
            for glossy in (False, True)
        }
        by_resolution.append(max(one["relative_rmse"] for one in found.values()))
        rows += [
            {"method": "VCF", "size": f"{resolution} spheres", "material": "glossy" if glossy else "Lambert",
             "light": "windows", **one}
            for glossy, one in found.items()
        ]  # fmt: skip
        if resolution == USUAL:
            figures["relative_rmse_vs_direct"] = by_resolution[-1]
            figures["bias"] = max(abs(one["bias"]) for one in found.values())
            figures["near_contact_rmse"] = max(one["near_rmse"] for one in found.values())
            rows += _others(room, bodies)
    figures["vcf_error_monotone"] = float(all(after < before for before, after in pairwise(by_resolution)))
    return Result(figures, rows)


def _rmse_of(found: Float64, truth: Float64, some: np.ndarray) -> float:
    return float(np.sqrt(np.square(found - truth)[some].mean()) / truth[some].mean()) if some.any() else 0.0


def _others(room: _Room, bodies: list[RelitBody]) -> list[dict[str, object]]:
    """Other lights, cuts and spacings of spheres."""
    rows: list[dict[str, object]] = []
    for name, environment in (("sky", sky()), ("sky and sun", sky(sun=1.0))):
        truth = room.truth(environment, glossy=True)
        found = room.found(bodies, environment, glossy=True)
        rows.append({"method": "VCF", "size": f"{USUAL} spheres", "material": "glossy", "light": name,
                     **errors(room, found, truth, glossy=True)})  # fmt: skip
    truth = room.truth(windows(), glossy=True)
    plans = {f"tolerance {t}": (ShellPlan(USUAL), t) for t in (0.002, 0.03)}
    plans["uniform spheres, the paper's"] = (ShellPlan(USUAL, "uniform"), TOLERANCE)
    for name, (plan, tolerance) in plans.items():
        found = room.found(room.relit(plan, tolerance), windows(), glossy=True)
        rows.append({"method": f"VCF, {name}", "size": f"{USUAL} spheres", "material": "glossy", "light": "windows",
                     **errors(room, found, truth, glossy=True)})  # fmt: skip
    return rows
