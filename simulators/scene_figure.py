"""A body that is no sphere, and the matt white card below it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from simulators.card import Card
from simulators.layout import SphereLayout
from simulators.samples.figure import figure_mesh
from simulators.samples.mesh import MeshSample
from simulators.scene import Array, Hits, Mask, among_matt

REACH_M = 10.0  # of rays: more than any distance of the rig


@dataclass(frozen=True)
class FigureScene:
    """The body at the origin and the card; the scene's frame is the rig's, unturned."""

    layout: SphereLayout
    seed: int

    @property
    def card(self) -> Card:
        """The card."""
        return Card(self.layout)

    @cached_property
    def body(self) -> MeshSample:
        """The body alone."""
        return MeshSample(figure_mesh(self.seed))

    def trace(self, origin: Array, directions: Array) -> Hits:
        """First hits of rays from one origin (3,) along unit directions (n, 3)."""
        found = self.body.trace(np.broadcast_to(origin, directions.shape), directions * REACH_M)
        body_at = np.full(len(directions), np.inf)
        body_at[found.ray] = np.linalg.norm(found.points - origin, axis=1)
        card_at = self.card.distance(origin, directions)
        ray = np.flatnonzero(np.minimum(body_at, card_at) < np.inf)
        points, normals = origin + card_at[ray, None] * directions[ray], self.card.normals(len(ray))
        of_body = np.searchsorted(ray, found.ray)
        points[of_body], normals[of_body] = found.points, found.normals
        return Hits(ray, points, normals, among_matt(len(ray), self.layout.card_albedo, of_body, found.material))

    def lit(self, hits: Hits, source: Array) -> Mask:
        """Which hits (n,) see the point source (3,)."""
        starts = hits.points + self.body.offset_m * hits.normals
        way = source - starts
        distance = np.linalg.norm(way, axis=1)
        facing = np.einsum("nk,nk->n", way, hits.normals) > 0
        past_card = ~(self.card.distance(starts, way / distance[:, None]) < distance)
        visible: Mask = facing & past_card & ~self.body.blocks(starts, way)
        return visible
