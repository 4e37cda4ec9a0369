"""Strengths of lights from the pictures: what was put in comes out."""

from dataclasses import replace

import numpy as np
import pytest

from processing.errors import ImageError
from processing.materials.light_strengths import divided, light_strengths
from processing.products import LightStack
from tests.reference import shapes


def stack_of(shape, lights, strengths, **surface):
    images = shapes.shaded(shape, lights, **surface) * strengths[:, None, None, None]
    noise = 0.001 * np.random.default_rng(1).standard_normal(images.shape)
    variance = np.full(images.shape, 1e-6, np.float32)
    return LightStack((images + noise).astype(np.float32), variance, lights, np.full(len(lights), np.inf), 1e-3)


@pytest.mark.parametrize("gloss", [0.0, 0.1])
def test_strengths_of_a_ball_under_twelve_lights(gloss):
    lights, given = shapes.dome(12, lowest_deg=35), np.random.default_rng(2).uniform(0.5, 1.5, 12)
    stack = stack_of(shapes.ball(30), lights, given, gloss=gloss)
    found = light_strengths(stack)
    np.testing.assert_allclose(found, given / np.exp(np.log(given).mean()), rtol=0.02)
    np.testing.assert_allclose(light_strengths(divided(stack, found)), 1.0, atol=0.01)


def test_pictures_that_tell_nothing_are_refused():
    with pytest.raises(ImageError, match="how strong"):
        light_strengths(stack_of(shapes.ball(8), shapes.dome(6), np.zeros(6)))
    with pytest.raises(ImageError, match="strengths of 5 lights"):
        light_strengths(stack_of(shapes.ball(8), shapes.dome(5), np.ones(5)))
    with pytest.raises(ImageError, match="flat"):
        light_strengths(stack_of(shapes.hills(12, seed=1, height=0.01), shapes.dome(6), np.ones(6)))


def test_unit_and_order_of_lights_do_not_matter():
    lights, given = shapes.dome(8, lowest_deg=35), np.random.default_rng(3).uniform(0.7, 1.4, 8)
    stack = stack_of(shapes.ball(16), lights, given)
    found = light_strengths(stack)
    np.testing.assert_allclose(light_strengths(divided(stack, np.full(8, 1e5))), found, rtol=1e-3)
    order = np.random.default_rng(4).permutation(8)
    turned = replace(
        stack, reflectance_cos=stack.reflectance_cos[order], variance=stack.variance[order],
        light_directions=lights[order],
    )  # fmt: skip
    np.testing.assert_allclose(light_strengths(turned), found[order], rtol=0.01)
