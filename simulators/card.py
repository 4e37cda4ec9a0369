"""The matt white card beside a body at the rig's origin."""

from dataclasses import dataclass

import numpy as np

from simulators.layout import SphereLayout
from simulators.scene import Array, Floats, Mask


@dataclass(frozen=True)
class Card:
    """The card in the plane x = 0, facing +x, outside of the sphere's radius."""

    layout: SphereLayout

    def distance(self, origin: Array, directions: Array) -> Array:
        """Distance (n,) to the card, infinity where it is missed, behind, or touched by the origin itself."""
        card = self.layout
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = -origin[..., 0] / directions[..., 0]
            y = origin[..., 1] + distance * directions[..., 1] - card.card_y_m
            z = origin[..., 2] + distance * directions[..., 2] - card.card_z_m
        inside = (np.abs(y) <= card.card_width_m / 2) & (np.abs(z) <= card.card_height_m / 2)
        return np.where(inside & (distance > 1e-6), distance, np.inf)

    def on_body(self, points: Array) -> Mask:
        """Which points (n, 3) of a body or the card are the body's."""
        inside: Mask = np.linalg.norm(points, axis=1) < self.layout.radius_m * 1.0001
        return inside

    def normals(self, count: int) -> Floats:
        """The card's normal, `count` times (n, 3)."""
        return np.tile(np.array([1, 0, 0], np.float32), (count, 1))
