"""Lights from their highlights on a chrome sphere, drawn ray by ray."""

import numpy as np
import pytest

from processing.errors import ImageError
from processing.materials.chrome_sphere import light_directions, sphere_of_mask
from tests.reference import shapes

SIZE = 120
LAMP_RAD = 0.05


def chrome(lights):
    """Images (light, y, x) of a mirror under small round lamps, and its mask."""
    _, normal = shapes.ball(SIZE, radius=0.8)
    x, y = shapes.grid(SIZE)
    mask = x**2 + y**2 < 0.8**2
    reflected = 2 * normal[..., 2:] * normal - np.array([0.0, 0.0, 1.0])
    seen = np.nan_to_num(np.einsum("yxi,li->lyx", reflected, lights), nan=-1.0)
    return np.where(seen > np.cos(LAMP_RAD), 1.0, 0.02) * mask, mask


def test_directions_are_those_of_the_lamps():
    lights = shapes.dome(8, lowest_deg=20)
    images, mask = chrome(lights)
    found = light_directions(images, sphere_of_mask(mask))
    # A pixel is 2.4 deg of reflection in the middle, more outward; the centroid of a spot errs by less than half.
    assert np.degrees(np.arccos(np.clip((found * lights).sum(axis=1), -1, 1))).max() < 1.0
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0)


def test_the_disc_of_a_mask():
    _, mask = chrome(shapes.dome(1))
    sphere = sphere_of_mask(mask)
    np.testing.assert_allclose(sphere.centre_px, (SIZE - 1) / 2, atol=1e-9)
    assert abs(sphere.radius_px - 0.4 * SIZE) < 0.05


def test_what_is_no_sphere_is_refused():
    with pytest.raises(ImageError, match="no disc"):
        sphere_of_mask(np.ones((30, 60), bool))
    with pytest.raises(ImageError, match="empty"):
        sphere_of_mask(np.zeros((30, 60), bool))


def test_an_image_without_a_usable_highlight_is_named():
    images, mask = chrome(shapes.dome(3))
    images[1] = 0.02 * mask
    with pytest.raises(ImageError, match=r"image 2: .* no highlight"):
        light_directions(images, sphere_of_mask(mask))
    with pytest.raises(ImageError, match=r"b\.jpg: .* no highlight"):
        light_directions(images, sphere_of_mask(mask), ["a.jpg", "b.jpg", "c.jpg"])
    images, mask = chrome(np.array([[0.9, 0.0, -np.sqrt(0.19)]]))
    with pytest.raises(ImageError, match=r"image 1: .* behind the picture"):
        light_directions(images, sphere_of_mask(mask))


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_the_unit_of_brightness_does_not_matter(scale):
    images, mask = chrome(shapes.dome(3))
    sphere = sphere_of_mask(mask)
    found = light_directions((scale * images).astype(np.float32), sphere)
    np.testing.assert_allclose(found, light_directions(images, sphere), atol=1e-6)
