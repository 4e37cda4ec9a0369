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
from render.scene import light
from render.shapes import plane, sphere, statue, torus
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
