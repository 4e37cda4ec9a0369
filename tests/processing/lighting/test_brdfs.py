"""Reflectances: they give back no more light than they get, and the same when eye and light change places."""

import numpy as np
import pytest

from processing.errors import ImageError
from processing.lighting import brdfs
from processing.products.blinn_phong import BlinnPhong
from processing.products.lafortune import LafortuneTexels
from processing.products.srf import Srf
from tests.reference.merl import angles_of

ONE, HALF, NONE = np.ones(3), np.full(3, 0.5), np.zeros(3)
MODELS = {
    "lambert": brdfs.lambert(ONE),
    "blinn_phong": brdfs.blinn_phong(HALF, HALF, 40.0),
    "broad blinn_phong": brdfs.blinn_phong(NONE, ONE, 1.0),
    "ward": brdfs.ward(HALF, HALF, (0.1, 0.4)),
    "ggx": brdfs.ggx(NONE, ONE, 0.3),
    "smooth ggx": brdfs.ggx(NONE, HALF, 0.05),
}


def hemisphere(count, rng):
    """Directions spread evenly by the cosine, whose mean of pi f is the albedo."""
    u, azimuth = rng.uniform(0, 1, count), rng.uniform(0, 2 * np.pi, count)
    level = np.sqrt(u)
    return np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sqrt(1 - u)])


def view(polar):
    return np.array([np.sin(polar), 0.0, np.cos(polar)])


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("polar", [0.0, 0.8, 1.3, 1.5])
def test_no_light_is_made(name, polar):
    lights = hemisphere(50_000, np.random.default_rng(1))
    found = MODELS[name].evaluate(lights, np.broadcast_to(view(polar), lights.shape))
    values = np.pi * found.mean(axis=0)
    error = 4 * np.pi * found.std(axis=0) / np.sqrt(len(lights))
    assert (values <= 1 + error + 1e-9).all()


def test_a_light_above_is_scattered_as_the_names_say():
    lights = hemisphere(400_000, np.random.default_rng(2))
    above = np.broadcast_to(view(0.0), lights.shape)
    for model, albedo in ((brdfs.lambert(HALF), 0.5), (brdfs.blinn_phong(NONE, HALF, 20.0), 0.5)):
        assert np.allclose(np.pi * model.evaluate(lights, above).mean(axis=0), albedo, rtol=0.02)


@pytest.mark.parametrize("name", MODELS)
def test_eye_and_light_change_places(name):
    rng = np.random.default_rng(3)
    one, two = hemisphere(1000, rng), hemisphere(1000, rng)
    assert np.allclose(MODELS[name].evaluate(one, two), MODELS[name].evaluate(two, one), rtol=1e-9)


@pytest.mark.parametrize("name", MODELS)
def test_nothing_comes_from_under_the_horizon(name):
    rng = np.random.default_rng(4)
    up = hemisphere(20, rng)
    down = up * [1, 1, -1]
    assert not MODELS[name].evaluate(up, down).any()
    assert not MODELS[name].evaluate(down, up).any()


def test_lobes_of_products_are_those_of_the_products():
    rng = np.random.default_rng(5)
    light, eye = hemisphere(200, rng), hemisphere(200, rng)
    parts = [0.1, 0.2, 0.3], [[-1, -0.9, 0.8]], [7], [[0.3, 0.2, 0.1]]
    one = LafortuneTexels(*(np.asarray([[part]], np.float32) for part in parts))
    zero = np.zeros(200, int)
    assert np.allclose(brdfs.mean_lafortune(one).evaluate(light, eye), one.evaluate(zero, zero, light, eye), rtol=1e-5)
    lobe = BlinnPhong(HALF, ONE, 9.0)
    srf = Srf(np.zeros((3, 1, 1, 3), np.float32), lobe, wrap=False)
    high = light[:, 2] > 0.02
    found = brdfs.mean_srf(srf).evaluate(light, eye) * light[:, 2:]
    assert np.allclose(found[high], lobe.evaluate(light, eye)[high], rtol=1e-9)


def test_a_table_is_what_it_was_made_of():
    """Linear in its three angles, so that interpolation is exact between the middles of cells."""
    rng = np.random.default_rng(6)
    light, eye = hemisphere(300, rng), hemisphere(300, rng)
    half, difference, azimuth = ((np.arange(n) + 0.5) / n for n in (40, 30, 20))
    values = (1 + half)[:, None, None, None] + difference[:, None, None] - 0.5 * azimuth[:, None] * ONE
    angles = np.stack(angles_of(light, eye)) / (np.pi / 2)
    folded = 1 - np.abs(1 - angles[2] % 2)
    expected = 1 + np.sqrt(angles[0]) + angles[1] - 0.5 * folded
    inner = (np.sqrt(angles[0]) > 0.02) & (angles[1] > 0.02) & (np.abs(folded - 0.5) < 0.47)
    assert inner.sum() > 200
    assert np.allclose(brdfs.tabulated(values).evaluate(light, eye)[inner, 0], expected[inner], rtol=1e-9)


def test_a_table_may_leave_out_the_azimuth():
    flat = brdfs.tabulated(np.full((4, 4, 1, 3), 0.2))
    lights = hemisphere(50, np.random.default_rng(7))
    assert np.allclose(flat.evaluate(lights, lights[::-1]), 0.2)
    with pytest.raises(ImageError, match="half, difference, azimuth"):
        brdfs.tabulated(np.full((4, 4, 3), 0.2))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -0.1])
def test_parameters_that_are_none_are_refused(bad):
    with pytest.raises(ImageError):
        brdfs.lambert(np.array([0.5, bad, 0.5]))
    with pytest.raises(ImageError):
        brdfs.tabulated(np.full((4, 4, 4, 3), bad))


def test_sharper_lobes_ask_for_finer_nodes():
    coarse, fine = (brdfs.blinn_phong(NONE, ONE, n).heights for n in (4.0, 400.0))
    assert coarse[0] > fine[0]
    assert fine[-1] >= fine[0]
