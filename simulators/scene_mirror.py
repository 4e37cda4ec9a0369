"""The polished black ball on its matt black plate, by the laws of reflection at a sphere."""

from dataclasses import dataclass

import numpy as np

from simulators.layout import MirrorLayout
from simulators.scene import Array, Floats, Hits, Mask, Material


@dataclass(frozen=True)
class MirrorScene:
    """The ball; the scene's frame is the sample frame, the plate lies in z = 0.

    A ray that meets the ball goes on to where its reflection ends: a hit is a point of the plate, dimmed by the ball
    where it is seen in it. What the lamps themselves look like in the ball is smaller than a pixel: `simulators.glint`.
    """

    layout: MirrorLayout

    def trace(self, origin: Array, directions: Array) -> Hits:
        """Last hits of rays from one origin (3,) along unit directions (n, 3)."""
        away = self._to_ball(origin, directions)
        bounced = np.flatnonzero(np.isfinite(away))
        starts = np.broadcast_to(origin, directions.shape).copy()
        ways, share = directions.copy(), np.ones(len(directions))
        starts[bounced] += away[bounced, None] * directions[bounced]
        normals = (starts[bounced] - self.layout.centre_m) / self.layout.radius_m
        cosine = -np.einsum("nk,nk->n", directions[bounced], normals)
        ways[bounced] += 2 * cosine[:, None] * normals
        share[bounced] = fresnel(cosine, self.layout.refractive_index)
        return self._on_plate(starts, ways, share)

    def lit(self, hits: Hits, source: Array) -> Mask:
        """Which hits (n,) see the point source (3,) past the ball."""
        way = source - hits.points
        visible: Mask = ~np.isfinite(self._to_ball(hits.points, way / np.linalg.norm(way, axis=1, keepdims=True)))
        return visible

    def _on_plate(self, starts: Array, ways: Array, share: Array) -> Hits:
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = -starts[:, 2] / ways[:, 2]
            points = starts + distance[:, None] * ways
            on = (ways[:, 2] < 0) & (np.abs(points[:, :2]).max(axis=1) <= self.layout.plate_m / 2)
        ray = np.flatnonzero(on)
        albedo: Floats = np.repeat((self.layout.plate_albedo * share[ray, None]).astype(np.float32), 3, axis=1)
        material = Material(albedo, np.zeros(len(ray), np.float32), np.ones(len(ray), np.float32))
        return Hits(ray, points[ray], np.tile(np.array([0, 0, 1], np.float32), (len(ray), 1)), material)

    def _to_ball(self, origin: Array, directions: Array) -> Array:
        """Distance (n,) to the ball's near side, infinity where it is missed or behind."""
        to_origin = origin - np.array(self.layout.centre_m)
        along = np.sum(to_origin * directions, axis=-1)
        square = along**2 - (np.sum(to_origin * to_origin, axis=-1) - self.layout.radius_m**2)
        with np.errstate(invalid="ignore"):
            near = -along - np.sqrt(square)
        return np.where((square > 0) & (near > 0), near, np.inf)


def fresnel(cosine: Array, index: float) -> Array:
    """Share of unpolarised light (n,) that a smooth surface of this refractive index reflects (Fresnel 1823)."""
    inside = np.sqrt(1 - (1 - cosine**2) / index**2)
    across = (cosine - index * inside) / (cosine + index * inside)
    along = (index * cosine - inside) / (index * cosine + inside)
    share: Array = (across**2 + along**2) / 2
    return share
