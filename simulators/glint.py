"""The image of a small lamp in a polished ball: smaller than a pixel, so it is not traced but placed.

Each point of the lamp's disc is reflected where the normal halves the angle between the ways to it and to the eye. The
image keeps the disc's radiance, so its light is radiance times the area in pixels that the disc's area is mapped to.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import erf

from simulators.layout import Array, CameraLayout, MirrorLayout
from simulators.lens import project
from simulators.scene import Floats
from simulators.scene_mirror import fresnel

RINGS = (1, 6, 12)  # points of the disc: the same area each
REACH_PX = 4  # of a spot, at least five standard deviations of its blur
_STEP_M = 1e-4

Disc = tuple[Array, float, Array]  # of a lamp: centre (3,), radius, and intensity (3,) in units of irradiance times m^2


@dataclass(frozen=True)
class Spots:
    """Points of light: place uv_px (n, 2) and the radiance times area in pixels (n, 3) of each."""

    uv_px: Array
    light: Array


def glint(mirror: MirrorLayout, disc: Disc, camera: CameraLayout, rig_from_scene: Array) -> Spots:
    """The lamp in the ball as the camera sees it; lamp and ball in the scene's frame. Under the plate it is hidden."""
    centre, radius_m, intensity = disc
    turn, place = rig_from_scene[:3, :3], rig_from_scene[:3, 3]
    eye = (camera.rig_from_camera[:3, 3] - place) @ turn
    points, sides = _disc_points(centre, radius_m, np.array(mirror.centre_m))

    def image(sources: Array) -> Array:
        seen = reflection_points(mirror, sources, eye)
        return project(camera, seen @ turn.T + place)

    along = [(image(points + _STEP_M * side) - image(points - _STEP_M * side)) / (2 * _STEP_M) for side in sides]
    area_px = np.abs(along[0][:, 0] * along[1][:, 1] - along[0][:, 1] * along[1][:, 0])
    at = reflection_points(mirror, points, eye)
    normals = (at - mirror.centre_m) / mirror.radius_m
    way = points - at
    cosine = np.einsum("nk,nk->n", normals, way) / np.linalg.norm(way, axis=1)
    share = fresnel(np.maximum(cosine, 0.0), mirror.refractive_index) * (1.0 - _under_plate(mirror, points, at))
    return Spots(image(points), (share * area_px / len(points))[:, None] * intensity)


def reflection_points(mirror: MirrorLayout, sources: Array, eye: Array) -> Array:
    """Points (n, 3) of the ball in which an eye (3,) sees point sources (n, 3); scene frame, metres."""
    centre = np.array(mirror.centre_m)
    normals = _unit(_unit(sources - centre) + _unit(eye - centre))
    for _ in range(30):  # each round gains a digit and more: the ball is small against the distances
        at = centre + mirror.radius_m * normals
        normals = _unit(_unit(sources - at) + _unit(eye - at))
    found: Array = centre + mirror.radius_m * normals
    return found


def add_spots(image: Floats, spots: Spots, blur_px: float) -> None:
    """Add points of light, blurred by a Gaussian of this deviation, to an image (h, w, 3) of radiance."""
    height, width = image.shape[:2]
    for (u, v), light in zip(spots.uv_px, spots.light, strict=True):
        left, top = round(u) - REACH_PX, round(v) - REACH_PX
        columns = np.arange(max(left, 0), min(left + 2 * REACH_PX + 1, width))
        rows = np.arange(max(top, 0), min(top + 2 * REACH_PX + 1, height))
        if columns.size and rows.size:
            share = _shares(rows, v, blur_px)[:, None] * _shares(columns, u, blur_px)
            image[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] += (share[..., None] * light).astype(np.float32)


def _shares(pixels: Array, centre: float, blur_px: float) -> Array:
    root = np.sqrt(2.0) * blur_px
    share: Array = (erf((pixels + 0.5 - centre) / root) - erf((pixels - 0.5 - centre) / root)) / 2
    return share


def _disc_points(centre: Array, radius_m: float, toward: Array) -> tuple[Array, tuple[Array, Array]]:
    """Points (n, 3) of a disc that faces `toward`, and two unit vectors along it."""
    axis = _unit(toward - centre)
    side = _unit(np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))]))
    other = np.cross(axis, side)
    bounds = np.sqrt(np.cumsum((0, *RINGS)) / sum(RINGS)) * radius_m
    points = [centre]
    for count, inner, outer in zip(RINGS[1:], bounds[1:], bounds[2:], strict=False):
        angle = 2 * np.pi * np.arange(count) / count
        middle = (inner + outer) / 2
        points += list(centre + middle * (np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * other))
    return np.array(points), (side, other)


def _under_plate(mirror: MirrorLayout, sources: Array, at: Array) -> Array:
    """Which ways (n,) from the ball to a source under the plane of the plate meet the plate."""
    below = sources[:, 2] < 0
    share = np.where(below, at[:, 2] / np.where(below, at[:, 2] - sources[:, 2], 1.0), 0.0)
    crossing = at + share[:, None] * (sources - at)
    hidden: Array = below & (np.abs(crossing[:, :2]).max(axis=1) <= mirror.plate_m / 2)
    return hidden


def _unit(vectors: Array) -> Array:
    unit: Array = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return unit
