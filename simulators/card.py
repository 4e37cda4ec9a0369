"""The matt white card beside a body at the rig's origin."""

from dataclasses import dataclass
from math import cos, sin

import numpy as np

from simulators.layout import SphereLayout
from simulators.scene import Array, Floats, Mask


@dataclass(frozen=True)
class Card:
    """The card in the plane through the origin that faces a camera of the layout's elevation, beside the sphere."""

    layout: SphereLayout

    @property
    def axes(self) -> tuple[Array, Array]:
        """Unit vectors (3,) up the card, as that camera sees it, and out of it toward the camera."""
        c, s = cos(self.layout.card_elevation_rad), sin(self.layout.card_elevation_rad)
        return np.array([-s, 0.0, c]), np.array([c, 0.0, s])

    def distance(self, origin: Array, directions: Array) -> Array:
        """Distance (n,) to the card, infinity where it is missed, behind, or touched by the origin itself."""
        card, (up, out) = self.layout, self.axes
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = -(origin @ out) / (directions @ out)
            right_m = origin[..., 1] + distance * directions[..., 1] - card.card_y_m
            up_m = origin @ up + distance * (directions @ up) - card.card_z_m
        inside = (np.abs(right_m) <= card.card_width_m / 2) & (np.abs(up_m) <= card.card_height_m / 2)
        return np.where(inside & (distance > 1e-6), distance, np.inf)

    def on_body(self, points: Array) -> Mask:
        """Which points (n, 3) of a body or the card are the body's."""
        inside: Mask = np.linalg.norm(points, axis=1) < self.layout.radius_m * 1.0001
        return inside

    def normals(self, count: int) -> Floats:
        """The card's normal, `count` times (n, 3)."""
        return np.tile(self.axes[1].astype(np.float32), (count, 1))
