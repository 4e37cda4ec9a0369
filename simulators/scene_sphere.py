"""A sphere of one of several materials, and the matt white card below it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulators.card import Card
from simulators.layout import SphereLayout
from simulators.samples.spheres import Surface
from simulators.scene import Array, Hits, Mask, among_matt


@dataclass(frozen=True)
class SphereScene:
    """The sphere at the origin and the card; the scene's frame is the rig's, unturned."""

    layout: SphereLayout
    seed: int
    surface: Surface

    @property
    def card(self) -> Card:
        """The card."""
        return Card(self.layout)

    def trace(self, origin: Array, directions: Array) -> Hits:
        """First hits of rays from one origin (3,) along unit directions (n, 3)."""
        sphere_at = self._to_sphere(origin, directions)
        card_at = self.card.distance(origin, directions)
        on_sphere, on_card = sphere_at < card_at, card_at < sphere_at
        ray = np.flatnonzero(on_sphere | on_card)
        points = origin + np.minimum(sphere_at, card_at)[ray, None] * directions[ray]
        return self._describe(ray, points, on_sphere[ray])

    def lit(self, hits: Hits, source: Array) -> Mask:
        """Which hits (n,) see the point source (3,); where light spreads below the surface, also those turned away."""
        way = source - hits.points
        distance = np.linalg.norm(way, axis=1)
        way = way / distance[:, None]
        facing = np.einsum("nk,nk->n", hits.points, way) > 0
        if hits.material.below is not None:
            facing |= hits.material.below.spread.max(axis=1) > 0
        past_sphere = ~(self._to_sphere(hits.points, way) < distance)
        past_card = ~(self.card.distance(hits.points, way) < distance)
        visible: Mask = np.where(self.card.on_body(hits.points), facing & past_card, past_sphere)
        return visible

    def normal_hits(self, normals: Array) -> Hits:
        """The sphere's points where its own, even normal is this (n, 3)."""
        points = normals * self.layout.radius_m
        return self._describe(np.arange(len(points)), points, np.ones(len(points), bool))

    def _describe(self, ray: NDArray[np.int64], points: Array, on_sphere: Mask) -> Hits:
        normals = self.card.normals(len(points))
        normals[on_sphere], material = self.surface(points[on_sphere] / self.layout.radius_m, self.seed)
        return Hits(ray, points, normals, among_matt(len(points), self.layout.card_albedo, on_sphere, material))

    def _to_sphere(self, origin: Array, directions: Array) -> Array:
        """Distance to the sphere's near side, infinity where it is missed or behind."""
        along = np.sum(origin * directions, axis=-1)
        square = along**2 - (np.sum(origin * origin, axis=-1) - self.layout.radius_m**2)
        with np.errstate(invalid="ignore"):
            near = -along - np.sqrt(square)
        return np.where((square > 0) & (near > 0), near, np.inf)
