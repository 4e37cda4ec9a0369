"""Pictures of a body of any shape, made from photographs of a sphere whose every value is known."""

from dataclasses import replace

import numpy as np
import pytest

from processing.cameras.calibration import CameraModel
from processing.cameras.lens import Pinhole
from processing.errors import ImageError
from processing.materials.light_pictures import light_stack
from processing.materials.photographs import BodyPhotographs
from processing.materials.sight import sight_of_body
from processing.materials.white_card import WhiteCard, card_irradiance
from tests.reference.sphere import photograph

CFA = np.array([[0, 1], [1, 2]], np.uint8)
RADIUS_M, DISTANCE, FOCAL_PX = 0.05, 22.0, 1500.0
CENTRE, SIZE = (101.3, 88.6), (200, 210)
CARD = WhiteCard(0.0, -0.065, 0.04, 0.011, 0.9)
ALBEDO, POWERS = 0.6, (5.0, 5.0, 2.0, 2.0)
# Two lamps, each at two places: from the sides and from above; the camera looks along its own z.
PLACES = 12 * np.array([[0.6, 0.0, -0.8], [-0.6, 0.0, -0.8], [0.0, -0.6, -0.8], [0.0, 0.6, -0.8]])


@pytest.fixture(scope="module")
def seen():
    """The rig frame is the camera's turned upright, its origin in the sphere's centre."""
    upright = np.diag([1.0, -1.0, -1.0, 1.0])
    upright[2, 3] = DISTANCE * RADIUS_M
    matrix = np.array([[FOCAL_PX, 0, CENTRE[0]], [0, FOCAL_PX, CENTRE[1]], [0, 0, 1]])
    return sight_of_body(CameraModel(Pinhole(matrix, np.zeros(5)), upright, SIZE), np.zeros(3))


@pytest.fixture(scope="module")
def shots(seen):
    card = (*np.array([CARD.right_m, CARD.up_m, CARD.width_m, CARD.height_m]) / RADIUS_M, CARD.reflectance)
    settings = {"size": SIZE, "centre": CENTRE, "focal_px": FOCAL_PX, "distance": DISTANCE, "albedo": ALBEDO}
    images = [photograph(place, **settings, card=card, samples=3) for place in PLACES]
    radiance = np.stack([power * image for power, image in zip(POWERS, images, strict=True)])
    away = np.linalg.norm(PLACES, axis=1)
    return BodyPhotographs(
        radiance, np.full(radiance.shape, 1e-8), CFA, PLACES / away[:, None], away * RADIUS_M, seen.radius_m,
        np.array([0, 0, 1, 1]),
    )  # fmt: skip


def test_a_matt_body_shows_albedo_and_cosine_and_the_card_is_no_part_of_it(shots, seen):
    stack = light_stack(shots, seen, CARD)
    rows, columns = stack.reflectance_cos.shape[1:3]
    reach = max(rows, columns) / 2 * stack.pixel_m
    assert RADIUS_M < reach < 1.08 * RADIUS_M  # the limb stands out by a thousandth, and pixels at it count whole
    points = _sphere_points(stack)
    near = np.linalg.norm(points[..., :2], axis=-1) < 0.6 * RADIUS_M
    way = stack.light_directions[:, None, None] * stack.light_distances_m[:, None, None, None] - points
    square = (way**2).sum(axis=-1)
    cosine = (way * points).sum(axis=-1) / np.sqrt(square) / RADIUS_M
    expected = ALBEDO / np.pi * np.maximum(cosine, 0) * stack.light_distances_m[:, None, None] ** 2 / square
    error = np.abs(stack.reflectance_cos - expected[..., None])[:, near]
    assert error.max() < 0.01 * ALBEDO / np.pi
    outside = np.linalg.norm(points[..., :2], axis=-1) > 1.06 * RADIUS_M
    assert np.isnan(stack.reflectance_cos[:, outside]).all()


def _sphere_points(stack):
    """Where the pixels' rays meet the sphere, view frame of the stack; the plane's own points beside it."""
    rows, columns = stack.reflectance_cos.shape[1:3]
    x, y = np.meshgrid(np.arange(columns) - (columns - 1) / 2, (rows - 1) / 2 - np.arange(rows))
    plane = np.stack([x * stack.pixel_m, y * stack.pixel_m, np.zeros(x.shape)], axis=-1)
    eye = np.array([0.0, 0.0, DISTANCE * RADIUS_M])
    way = (plane - eye) / np.linalg.norm(plane - eye, axis=-1, keepdims=True)
    along = -(way @ eye)
    square = along**2 - (eye @ eye - RADIUS_M**2)
    return np.where((square > 0)[..., None], eye + (along - np.sqrt(np.maximum(square, 0)))[..., None] * way, plane)


def test_each_lamp_is_read_by_itself_and_a_shadowed_card_by_its_own_lamp(shots, seen):
    """The first light of the second lamp comes from above, where the sphere hides the card from it."""
    body = replace(shots, radius_m=RADIUS_M)
    above = np.array([0.0, -0.95, -np.sqrt(1 - 0.95**2)])
    hidden = replace(body, light_directions=np.insert(body.light_directions[[0, 1, 3]], 2, above, axis=0))
    reading = card_irradiance(hidden, replace(seen, radius_m=RADIUS_M), CARD)
    np.testing.assert_allclose(reading, np.array(POWERS)[:, None] * np.ones(3), rtol=5e-3)
    np.testing.assert_array_equal(reading[2], reading[3])


def test_a_lamp_that_never_reaches_the_card_is_an_error(shots, seen):
    body = replace(shots, radius_m=RADIUS_M, lamps=np.array([0, 0, 1, 2]))
    above = np.array([0.0, -0.95, -np.sqrt(1 - 0.95**2)])
    hidden = replace(body, light_directions=np.insert(body.light_directions[[0, 1, 3]], 2, above, axis=0))
    with pytest.raises(ImageError, match="lamp 2 of 3"):
        card_irradiance(hidden, replace(seen, radius_m=RADIUS_M), CARD)


@pytest.mark.parametrize("value", [0.0, np.nan], ids=["dark", "missing"])
def test_no_body_is_one_clear_error(shots, seen, value):
    with pytest.raises(ImageError, match="no body found"):
        light_stack(replace(shots, radiance=np.full(shots.radiance.shape, value)), seen, CARD)


def test_lights_and_lamps_must_agree(shots):
    with pytest.raises(ImageError, match="lamps"):
        replace(shots, lamps=np.zeros(3, int))
