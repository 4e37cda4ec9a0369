"""SBRDF+: the shader meets NumPy whatever the texels hold, and nothing jumps while light, eye or surface move."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from processing.products import LafortuneTexels, SbrdfPlus
from render.comparison import gl_vs_reference
from render.materials import outgoing
from render.mesh import Mesh
from render.reference import ReferenceRenderer
from render.sbrdf import ANISOTROPY, side_texels
from render.scene import Scene, framed, light
from render.shapes import captured_sphere, plane, sphere, statue, torus
from tests.render import synthetic

BOUND = 1e-3  # as in test_shaders


def mirrored(mesh: Mesh) -> Mesh:
    """The same surface under a texture that is seen from behind."""
    tangents = mesh.tangents * np.array([-1.0, -1.0, -1.0, -1.0])
    return replace(mesh, uv=mesh.uv * np.array([-1.0, 1.0]), tangents=tangents)


MESHES = {
    "poles": sphere(shape=(16, 24)),
    "mirrored": mirrored(torus()),
    "statue": statue(shape=(87, 60)),
    "many tiles": plane(tiles=(30.0, 20.0)),
}


@pytest.fixture(scope="module")
def levels() -> SbrdfPlus:
    """Six levels, 24 x 20 texels to one."""
    return synthetic.levelled()


@pytest.mark.parametrize("name", MESHES)
def test_shader_equals_reference_on_every_surface(gl, sbrdf, name):
    assert gl_vs_reference(sbrdf, MESHES[name], size=(100, 100), renderer=gl) <= BOUND


@pytest.mark.parametrize("hidden", [0.0, 0.02, 1.1])
@pytest.mark.parametrize("lobes", [0, 1, 3])
def test_shader_equals_reference_with_any_share_of_hidden_points(gl, lobes, hidden):
    material = synthetic.weave((9, 14), lobes=lobes, hidden=hidden)
    assert gl_vs_reference(material, torus(), size=(80, 80), renderer=gl) <= BOUND


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    shape=st.tuples(st.integers(1, 9), st.integers(1, 9)),
    lobes=st.integers(0, 4),
    centres=st.sampled_from([0, 1, 70]),
    exponent=st.sampled_from([1.0, 30.0, 3000.0]),
    seed=st.integers(0, 1000),
)
def test_shader_equals_reference_for_any_tile(gl, shape, lobes, centres, exponent, seed):
    material = synthetic.weave(shape, lobes=lobes, centres=centres, largest_exponent=exponent, seed=seed)
    assert gl_vs_reference(material, MESHES["many tiles"], size=(50, 50), renderer=gl) <= BOUND


def test_absent_lobes_are_skipped_wherever_they_stand(gl, sbrdf):
    """Texels differ in which of their three lobes there are; none has all."""
    absent = np.random.default_rng(4).integers(0, 3, sbrdf.lobes.shape)[..., None] == np.arange(3)
    lobes = sbrdf.lobes
    fewer = LafortuneTexels(
        lobes.diffuse,
        np.where(absent[..., None], np.float32(0.0), lobes.axis),
        np.where(absent, np.float32(1.0), lobes.exponent),
        np.where(absent[..., None], np.float32(0.0), lobes.albedo),
    )
    assert gl_vs_reference(replace(sbrdf, lobes=fewer), torus(), size=(80, 80), renderer=gl) <= BOUND


def test_light_or_eye_under_the_horizon_is_black(gl, sbrdf):
    below, above = np.array([[0.6, 0.0, -0.8]]), np.array([[0.6, 0.0, 0.8]])
    place = np.full((1, 2), 0.3)
    assert (outgoing(sbrdf, place, below, above) == 0.0).all()
    assert (outgoing(sbrdf, place, above, below) == 0.0).all()
    lights = (light(0.3, np.radians(-4.0)), light(0.3, np.radians(2.0)))
    assert gl_vs_reference(sbrdf, sphere(), lights, (60, 60), renderer=gl) <= BOUND


@pytest.mark.parametrize("tiles", [0.2, 5.0, 60.0, 2000.0])
def test_shader_equals_reference_on_every_level(gl, levels, tiles):
    """From magnified to a tile in less than a pixel; the finest alone, two blended, the coarsest alone."""
    assert gl_vs_reference(levels, plane(tiles=(tiles, 0.7 * tiles)), size=(80, 80), renderer=gl) <= BOUND


@pytest.mark.parametrize("name", MESHES)
def test_levels_on_every_surface(gl, levels, name):
    assert gl_vs_reference(levels, MESHES[name], size=(80, 80), renderer=gl) <= BOUND


def test_levels_on_a_captured_sphere(gl, levels):
    assert gl_vs_reference(levels, captured_sphere(shape=(32, 64)), size=(80, 80), renderer=gl) <= BOUND


def test_reference_draws_the_same_levels_as_the_shader(gl, levels):
    """Both find by themselves what a pixel covers: the card from its neighbours, the reference from the triangle."""
    mesh = torus(tiles=(40.0, 14.0))
    camera = framed(mesh, (96, 96), azimuth_rad=-0.6, elevation_rad=0.5)
    scene = Scene.of(mesh, levels, camera, (light(0.4, 0.9),))
    card, plain = gl.draw(scene), ReferenceRenderer().draw(scene)
    both = card.mask & plain.mask
    error = np.abs(card.radiance - plain.radiance)[both]
    # Derivatives are those of two pixels by two on the card, of each pixel here: some 3 % of a level apart.
    assert np.median(error) <= 0.01 * plain.radiance[both].mean()
    assert both.sum() >= 0.98 * plain.mask.sum()


def test_side_of_what_a_pixel_covers():
    """The shorter axis, whatever the turn, unless the longer one is more than ANISOTROPY times longer; at least 1."""
    turn = np.array([[np.cos(0.4), np.sin(0.4)], [-np.sin(0.4), np.cos(0.4)]])
    axes = np.stack([np.diag(sides) for sides in ([5.0, 4.0], [4.0, 5.0], [40.0, 4.0], [0.2, 0.1], [0.0, 0.0])])
    expected = [4.0, 4.0, 40.0 / ANISOTROPY, 1.0, 1.0]
    texels = np.array([8.0, 16.0])  # a row of 8, so u first
    for footprint in (axes, turn @ axes, axes @ turn):
        np.testing.assert_allclose(side_texels(footprint / texels, (16, 8)), expected, rtol=1e-9)


def test_lobes_are_not_asked_below_what_was_measured(sbrdf):
    """A light or an eye that sinks to the horizon sees what it saw at the lowest ring, but for the light's cosine."""
    uv = np.random.default_rng(7).uniform(size=(40, 2))
    one = np.tile(sbrdf.lights.directions[-3], (40, 1))
    level = one[0, :2] / np.linalg.norm(one[0, :2])
    low = np.tile([*np.cos(0.02) * level, np.sin(0.02)], (40, 1))
    expected = sbrdf.evaluate(uv, one, one)
    np.testing.assert_allclose(sbrdf.evaluate(uv, one, low), expected, rtol=1e-9)
    np.testing.assert_allclose(sbrdf.evaluate(uv, low, one), expected * low[:, 2:] / one[:, 2:], rtol=1e-9)


@pytest.mark.parametrize("moving", ["light", "eye", "surface"])
def test_nothing_jumps(levels, moving):
    """Steps a tenth as long change pictures a tenth as much: between texels, views and lights, at hidden points too."""
    coarse, fine = (largest_step(levels, moving, count) for count in (401, 4001))
    assert fine <= 0.25 * coarse


def largest_step(material: SbrdfPlus, moving: str, count: int) -> float:
    """Largest change between steps along six ways, of what is there."""
    rng = np.random.default_rng(5)
    along = np.linspace(0.0, 1.0, count)[:, None]
    steps = []
    for _ in range(6):
        ends = {"surface": rng.uniform(0, 2, (2, 2)), **{name: above(rng, 2) for name in ("light", "eye")}}
        still = {name: np.repeat(rows[:1], count, axis=0) for name, rows in ends.items()}
        start, end = ends[moving]
        still[moving] = start + along * (end - start)
        uv, light, view = (still[name] for name in ("surface", "light", "eye"))
        light, view = (rows / np.linalg.norm(rows, axis=1, keepdims=True) for rows in (light, view))
        steps.append(np.abs(np.diff(outgoing(material, uv, light, view), axis=0)).max())
    return max(steps)


def above(rng: np.random.Generator, count: int) -> np.ndarray:
    """Directions (count, 3) above the horizon, down to 7 degrees."""
    rows = rng.normal(size=(count, 3))
    rows[:, 2] = np.abs(rows[:, 2]) + 0.15 * np.linalg.norm(rows, axis=1)
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def test_a_flat_matt_tile_is_its_colour_times_the_cosine(gl):
    """No lobe, no shadow, no shift, nothing hidden: Lambert."""
    base = synthetic.weave((3, 4), lobes=0, hidden=0.0)
    diffuse = np.broadcast_to(np.float32([0.2, 0.1, 0.05]), (3, 4, 3))
    matt: SbrdfPlus = replace(
        base,
        lobes=replace(base.lobes, diffuse=diffuse),
        shadow=np.ones_like(base.shadow),
        shift=np.zeros_like(base.shift),
    )
    directions = synthetic.hemisphere()
    uv = np.random.default_rng(1).uniform(size=(len(directions), 2))
    value = outgoing(matt, uv, directions, directions[::-1])
    np.testing.assert_allclose(value, directions[:, 2:] * diffuse[0, 0], rtol=1e-6)
    assert gl_vs_reference(matt, torus(), size=(50, 50), renderer=gl) <= 1e-5
