"""How a camera sees points about a body's centre.

Points are in radii of the body, in the frame of `products.sphere`: x along the image's columns, y down its rows, z from
the camera to the centre.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from processing.cameras.calibration import CameraModel
from processing.errors import ImageError
from processing.materials.limb import SphereImage
from processing.products.arrays import Float64


class Sight(Protocol):
    """Where a camera sees what."""

    @property
    def view_distance(self) -> float:
        """Distance of the camera from the centre in radii; infinite where it sees orthographically."""
        ...

    def image_points(self, points: Float64) -> Float64:
        """Image points (..., 2) as column, row of points (..., 3)."""
        ...


@dataclass(frozen=True, eq=False)
class CircleSight:
    """A sphere before a camera of which only the distance is known: the circle of its limb tells the rest."""

    sphere: SphereImage
    view_distance: float

    def image_points(self, points: Float64) -> Float64:
        """As of `Sight`.

        Under orthographic projection (infinite distance) they are r (x, y) from the circle's centre, the paper's eq. 1.
        From D radii away the limb is the cone that touches the sphere, of radius r = f / sqrt(D^2 - 1), and a point at
        depth D + z is seen at r (x, y) sqrt(D^2 - 1) / (D + z).
        """
        circle, distance = self.sphere, self.view_distance
        if np.isinf(distance):
            return np.asarray(circle.centre_px + circle.radius_px * points[..., :2], np.float64)
        magnified = np.sqrt(distance**2 - 1) / (distance + points[..., 2:])
        return np.asarray(circle.centre_px + circle.radius_px * points[..., :2] * magnified, np.float64)


@dataclass(frozen=True, eq=False)
class CalibratedSight:
    """A body before a calibrated camera: its centre and the axes of its frame, `rig_from_view` (3, 3), in the rig's."""

    camera: CameraModel
    centre_m: Float64
    rig_from_view: Float64
    radius_m: float

    @property
    def view_distance(self) -> float:
        """As of `Sight`."""
        return float(np.linalg.norm(self.camera.centre_m - self.centre_m)) / self.radius_m

    def image_points(self, points: Float64) -> Float64:
        """As of `Sight`: through the camera's lens with its distortion."""
        return self.camera.project(self.centre_m + self.radius_m * points @ self.rig_from_view.T)


def sight_toward(camera: CameraModel, centre_m: Float64, radius_m: float) -> CalibratedSight:
    """The sight of a body whose centre (3,) in the rig frame is known."""
    z = centre_m - camera.centre_m
    z = z / np.linalg.norm(z)
    x = camera.rig_from_camera[:3, 0] - (camera.rig_from_camera[:3, 0] @ z) * z
    x = x / np.linalg.norm(x)
    return CalibratedSight(camera, centre_m, np.column_stack([x, np.cross(z, x), z]), radius_m)


def sight_of_sphere(camera: CameraModel, sphere: SphereImage, radius_m: float) -> CalibratedSight:
    """The sight of a sphere whose limb was found: distortion and the slant of a sphere off the axis are accounted for.

    The rays r through the limb lie on a cone about the unit vector a toward the centre, r . a = cos alpha: linear in
    a / cos alpha. The sphere touches it at the distance R / sin alpha. Raises ImageError where the limb is not in the
    lens's field.
    """
    rays = camera.rays(sphere.limb_px)
    if not np.isfinite(rays).all():
        raise ImageError("the sphere's limb lies where the calibrated lens forms no image; is it this camera's?")
    axis, *_ = np.linalg.lstsq(rays, np.ones(len(rays)))
    cosine = 1 / np.linalg.norm(axis)
    distance_m = radius_m / np.sqrt(1 - cosine**2)
    return sight_toward(camera, camera.centre_m + distance_m * cosine * axis, radius_m)


def sight_of_body(camera: CameraModel, centre_m: Float64) -> CalibratedSight:
    """The sight of a body of any shape about this place (3,) of the rig frame; its radius is half the field of view."""
    distance_m = float(np.linalg.norm(camera.centre_m - centre_m))
    focal_px = float(camera.lens.matrix[[0, 1], [0, 1]].min())
    return sight_toward(camera, centre_m, max(camera.size) / 2 / focal_px * distance_m)
