"""A matt sphere and a white card before a pinhole camera, ray by ray: independent of gradient space.

Camera axes: x right, y down, z forward; the sphere stands at (0, 0, distance) plus the given shift of the image.
"""

import numpy as np


def photograph(light, *, size, centre, focal_px, distance, albedo, card=None, samples=3):
    """Radiance (row, column) under a point light of unit irradiance at the sphere's centre.

    `light` is its position relative to the centre, lengths in sphere radii; `centre` the image point of the sphere's
    centre; `card` = (right, up, width, height, albedo), in the plane through the centre, facing the camera.
    """
    height, width = size
    sub = (np.arange(samples) + 0.5) / samples - 0.5
    row, column, down, right = np.meshgrid(np.arange(height), np.arange(width), sub, sub, indexing="ij")
    way = np.stack([column + right - centre[0], row + down - centre[1], np.full(row.shape, focal_px)], axis=-1)
    way /= np.linalg.norm(way, axis=-1, keepdims=True)
    eye = np.array([0.0, 0.0, -distance])
    along = -(way @ eye)
    square = along**2 - (distance**2 - 1)
    hit = square > 0
    points = eye + (along - np.sqrt(np.maximum(square, 0)))[..., None] * way
    image = np.where(hit, albedo / np.pi * irradiance(points, points, light), 0.0)
    if card is not None:
        on_plane = eye + (distance / way[..., 2])[..., None] * way
        inside = (np.abs(on_plane[..., 0] - card[0]) < card[2] / 2) & (np.abs(on_plane[..., 1] + card[1]) < card[3] / 2)
        lit = ~shadowed(on_plane, light)
        facing = np.broadcast_to([0.0, 0.0, -1.0], on_plane.shape)
        white = card[4] / np.pi * irradiance(on_plane, facing, light) * lit
        image = np.where(hit, image, np.where(inside, white, 0.0))
    return image.mean(axis=(2, 3))


def irradiance(points, normals, light):
    """Irradiance on points with these normals; 1 at the origin facing the light."""
    way = light - points
    squared = (way * way).sum(axis=-1)
    cosine = (way * normals).sum(axis=-1) / np.sqrt(squared)
    return np.maximum(cosine, 0) * (light @ light) / squared


def shadowed(points, light):
    """Whether the unit sphere stands between points and light."""
    way = light - points
    way = way / np.linalg.norm(way, axis=-1, keepdims=True)
    along = (points * way).sum(axis=-1)
    return (along < 0) & ((points * points).sum(axis=-1) - along**2 < 1)


def arm_lights(azimuths_deg, distance=12.0):
    """Light positions (n, 3) on a horizontal circle, azimuth 0 at the camera, positive to the image's right."""
    azimuth = np.radians(azimuths_deg)
    return distance * np.stack([np.sin(azimuth), np.zeros_like(azimuth), -np.cos(azimuth)], axis=1)
