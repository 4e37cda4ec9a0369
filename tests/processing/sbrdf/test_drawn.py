"""Measured views given back by lobes, shadows, shifts and clusters."""

from dataclasses import replace

import numpy as np
import pytest

from processing.products import Btf
from processing.sbrdf.drawn import DrawnLobes, DrawnPlus, view_errors
from tests.render import synthetic

SHAPE = (6, 5)


@pytest.fixture(scope="module")
def product():
    return synthetic.weave(SHAPE, largest_exponent=12.0)


def centres_of_texels():
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return np.stack([columns + 0.5, rows + 0.5], axis=-1).reshape(-1, 2) / SHAPE[::-1]


def told_alone(mesh):
    """Measured directions at which the mesh weighs no other."""
    index, weight = mesh.weights(mesh.directions)
    own = np.where(index == np.arange(len(index))[:, None], weight, 0).sum(axis=1)
    return np.flatnonzero((own > 1 - 1e-9) & (mesh.directions[:, 2] > 0.1))


def test_it_is_what_evaluate_gives_at_measured_directions(product):
    lights, views = told_alone(product.lights), told_alone(product.views)
    assert min(len(lights), len(views)) >= 3
    uv = centres_of_texels()
    for view in views[:4]:
        drawn = DrawnPlus(product).seen_from(int(view))
        for light in lights:
            directions = (np.broadcast_to(mesh.directions[n], (len(uv), 3)) for mesh, n in
                          ((product.lights, light), (product.views, view)))  # fmt: skip
            expected = product.evaluate(uv, *directions).reshape(*SHAPE, 3)
            np.testing.assert_allclose(drawn[light], expected, atol=2e-5 * expected.max())


def test_without_shifts_and_hidden_points_it_is_lobes_and_shadows(product):
    plain = replace(product, shift=np.zeros_like(product.shift), hidden=np.zeros_like(product.hidden))
    lights, views = product.lights.directions, product.views.directions
    for view in (0, 7):
        stvs = DrawnLobes(product.lobes, lights, views, product.shadow).seen_from(view)
        np.testing.assert_array_equal(DrawnPlus(plain).seen_from(view), stvs)
        bare = DrawnLobes(product.lobes, lights, views).seen_from(view)
        np.testing.assert_allclose(bare * product.shadow[..., None], stvs)


def test_errors_are_of_what_was_measured(product):
    """A BTF that the product draws itself, its last texel missing; then one that is a tenth brighter."""
    lights, views = product.lights.directions, product.views.directions
    drawn = DrawnPlus(product)
    cosine = np.maximum(lights[:, 2], 1e-9)[:, None, None, None]
    seen = np.stack([drawn.seen_from(view) / cosine for view in range(len(views))], axis=1)
    seen[..., -1, -1, :] = np.nan
    assert view_errors(Btf(seen, lights, views), drawn.seen_from).relative() < 1e-10
    brighter = view_errors(Btf(1.1 * seen, lights, views), drawn.seen_from)
    assert brighter.relative() == pytest.approx((0.1 / 1.1) ** 2, rel=1e-4)
    assert brighter.relative(np.arange(len(views)) > 3) == pytest.approx((0.1 / 1.1) ** 2, rel=1e-4)
    nothing = Btf(np.full_like(seen, np.nan), lights, views)
    assert np.isnan(view_errors(nothing, drawn.seen_from).relative())
