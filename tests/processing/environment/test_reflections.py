"""Reflections of the frame on made-up scenes: whichever way they differ from them, and what is none."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from processing.environment.image_circle import CircleStatus, ImageCircle
from processing.environment.reflections import find_reflections

SIZE, RADIUS = 240, 110.0
CIRCLE = ImageCircle(np.array([119.5, 119.5]), RADIUS, 0.05, 1.0, CircleStatus.FOUND)


def scenes(seed):
    """Two different smooth places, about 1."""
    rng = np.random.default_rng(seed)
    return [np.exp(np.stack([gaussian_filter(rng.normal(size=(SIZE, SIZE)), 25) * 6 for _ in range(3)], axis=-1))
            for _ in range(2)]  # fmt: skip


def sector(azimuth_rad, half_width_rad=0.25, middle=0.88, half_height=0.035):
    """Share (h, w) that a reflection hides: 1 inside, soft by two pixels at its edges."""
    rows, columns = np.indices((SIZE, SIZE))
    x, y = columns - 119.5, rows - 119.5
    radius = np.hypot(x, y)
    around = (np.abs((np.arctan2(y, x) - azimuth_rad + np.pi) % (2 * np.pi) - np.pi) - half_width_rad) * radius
    outside = np.maximum(around, np.abs(radius - middle * RADIUS) - half_height * RADIUS)
    return 1 / (1 + np.exp(np.clip(outside, -50, 50)))


def with_patch(pictures, share, lights):
    return [picture * (1 - share[..., None]) + share[..., None] * np.asarray(light)
            for picture, light in zip(pictures, lights, strict=True)]  # fmt: skip


def overlap(found, share):
    true = share > 0.1
    return (found & true).sum() / (found | true).sum()


CASES = {
    "brighter than both": ((3.0,) * 3, (3.0,) * 3),
    "darker than both": ((0.2,) * 3, (0.2,) * 3),
    "brighter than one, darker than the other": ((2.5,) * 3, (0.3,) * 3),
}


@pytest.mark.parametrize("lights", CASES.values(), ids=CASES.keys())
def test_a_reflection_is_found_whichever_way_it_differs(lights):
    """Also across azimuth 0."""
    share = sector(0.0)
    front, back = with_patch(scenes(1), share, lights)
    found = find_reflections(front, back, (CIRCLE, CIRCLE))
    assert overlap(found.front, share) > 0.6
    assert overlap(found.back, share) > 0.6


def test_a_reflection_as_bright_as_the_scene_is_found_by_its_colour():
    share, pictures = sector(1.0), scenes(2)
    blue = [picture.mean(axis=-1, keepdims=True) * np.array([0.6, 0.9, 1.5]) for picture in pictures]
    grey = [
        picture * (1 - share[..., None]) + share[..., None] * picture.mean(axis=-1, keepdims=True) for picture in blue
    ]
    found = find_reflections(*grey, (CIRCLE, CIRCLE))
    assert overlap(found.front, share) > 0.6


def test_what_only_one_picture_shows_is_no_reflection():
    share, pictures = sector(1.0), scenes(3)
    front, _ = with_patch(pictures, share, ((3.0,) * 3,) * 2)
    found = find_reflections(front, pictures[1], (CIRCLE, CIRCLE))
    assert overlap(found.front, share) < 0.1


def test_a_lamp_is_never_taken_for_a_reflection():
    """At the same place of both pictures: what a frame mirrors is no lamp."""
    share, pictures = sector(1.0), scenes(4)
    front, back = with_patch(pictures, share, ((400.0,) * 3,) * 2)
    found = find_reflections(front, back, (CIRCLE, CIRCLE))
    assert not found.front[share > 0.5].any()


def test_the_unit_of_light_does_not_matter():
    front, back = with_patch(scenes(5), sector(2.5), ((3.0,) * 3,) * 2)
    masks = [find_reflections(a * front, b * back, (CIRCLE, CIRCLE)).front for a, b in ((1.0, 1.0), (1e-4, 1e3))]
    assert (masks[0] != masks[1]).mean() < 1e-3


def test_pictures_without_light_or_numbers_have_none():
    for value in (0.0, np.nan):
        picture = np.full((SIZE, SIZE, 3), value)
        assert not find_reflections(picture, picture, (CIRCLE, CIRCLE)).front.any()
