"""Each shader gives the values of its NumPy reference on exactly the same inputs.

The bound is 1e-3 of the value (of a thousandth of the peak where the value is smaller). float32 rounds terms of the
size of the peak to 6e-8 of it, which is 6e-5 of that floor; a dozen such terms stay under the bound.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from processing.products import AnisotropicPhong, BlinnPhong, DirectionMesh, FactoredBtf, ResidualBasis
from render.comparison import gl_vs_reference, relative_error
from render.errors import MaterialError
from render.materials import outgoing, upload
from render.scene import light
from render.shapes import captured_sphere, plane, sphere, torus, vase
from render.srf import repeating
from tests.render import synthetic

BOUND = 1e-3
MESHES = {"sphere": sphere(), "plane": plane(tiles=(2.0, 3.0)), "torus": torus(), "vase": vase(shape=(48, 64))}


@pytest.fixture(params=["srf", "btf", "sbrdf", "flat"])
def material(request):
    return request.getfixturevalue(request.param)


@pytest.mark.parametrize("name", MESHES)
def test_shader_equals_reference(gl, material, name):
    assert gl_vs_reference(material, MESHES[name], size=(160, 160), renderer=gl) <= BOUND


def test_captured_sphere_equals_reference(gl):
    """A map that ends, found by the normal."""
    material = synthetic.stone(64, 64, wrap=False)
    assert gl_vs_reference(material, captured_sphere(), size=(160, 160), renderer=gl) <= BOUND


def test_map_that_ends_is_clamped_beyond_its_border(gl):
    material = synthetic.stone(33, 47, wrap=False)
    assert gl_vs_reference(material, plane(tiles=(5.0, 5.0)), size=(120, 120), renderer=gl) <= BOUND


def test_undetermined_texels_count_as_zero(gl, srf):
    holes = srf.residual.copy()
    holes[:, ::3, ::2] = np.nan
    assert gl_vs_reference(replace(srf, residual=holes), MESHES["plane"], size=(120, 120), renderer=gl) <= BOUND


@pytest.mark.parametrize("basis", ResidualBasis)
@pytest.mark.parametrize("turn_rad", [0.0, 0.9])
def test_every_basis_and_a_drawn_out_lobe_equal_the_reference(gl, srf, basis, turn_rad):
    residual = 0.05 * np.random.default_rng(3).normal(size=(3, 16, 12, basis.size)).astype(np.float32)
    lobe = AnisotropicPhong(srf.phong.diffuse, srf.phong.specular, np.array([8.0, 120.0]), turn_rad)
    material = replace(srf, residual=residual, phong=lobe, basis=basis)
    assert gl_vs_reference(material, MESHES["torus"], size=(120, 120), renderer=gl) <= BOUND


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    exponent=st.one_of(st.just(0.0), st.floats(0.05, 2000.0)),
    diffuse=st.floats(0.0, 0.3),
    specular=st.floats(0.0, 5.0),
    azimuth=st.floats(0.0, 360.0),
    elevation=st.floats(-10.0, 90.0),
)
def test_lobe_equals_reference_for_every_exponent(gl, srf, exponent, diffuse, specular, azimuth, elevation):
    lobe = BlinnPhong(np.full(3, diffuse), np.array([specular, 0.5 * specular, 0.0]), exponent)
    lit = (light(np.radians(azimuth), np.radians(elevation)),)
    assert gl_vs_reference(replace(srf, phong=lobe), MESHES["torus"], lit, (64, 64), renderer=gl) <= BOUND


@pytest.mark.parametrize("exponent", [0.3, 1.0, 5.0, 20.0, 80.0, 500.0, 1e4])
def test_lobe_alone_is_exact_to_a_few_float32_steps(gl, exponent):
    """A driver's pow() is off by 1e-5 and more; five terms of the size of the lobe round to 3e-7."""
    lobe = BlinnPhong(np.zeros(3), np.ones(3), exponent)
    material = replace(synthetic.stone(4, 4), residual=np.zeros((3, 4, 4, 3), np.float32), phong=lobe)
    assert gl_vs_reference(material, MESHES["sphere"], size=(120, 120), renderer=gl) <= 4e-6


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 1000), count=st.integers(3, 40), rank=st.integers(1, 6))
def test_btf_equals_reference_for_any_set_of_directions(gl, seed, count, rank):
    """Also outside the hull of the measured directions, and with different ones for light and view."""
    rng = np.random.default_rng(seed)
    sets = []
    for n in (count, count + 1):
        rows = rng.normal(size=(n, 3))
        rows[:, 2] = np.abs(rows[:, 2] + 1.0)
        sets.append(rows / np.linalg.norm(rows, axis=1, keepdims=True))
    lights, views = (DirectionMesh.from_directions(rows) for rows in sets)
    base = synthetic.lambertian((0.5, 0.4, 0.3))
    material = replace(
        base,
        eigenmaps=rng.uniform(0.2, 1.0, (rank, count, 5, 7, 3)).astype(np.float32),
        weights=rng.uniform(-0.2, 1.0, (rank, count + 1)).astype(np.float32),
        lights=lights,
        views=views,
    )
    # Slivers of the triangulation amplify rounding: only well-shaped sets are compared.
    if min(_smallest_area(mesh) for mesh in (lights, views)) > 1e-3:
        assert gl_vs_reference(material, MESHES["sphere"], size=(64, 64), renderer=gl) <= BOUND


@pytest.mark.parametrize("kind", [None, np.uint8, np.float16])
@pytest.mark.parametrize("rank", [1, 5])
def test_grey_and_coded_btf_equal_the_reference(gl, kind, rank):
    """Ranks that fill no whole four; maps whose light and view directions differ in number."""
    rng = np.random.default_rng(rank)
    directions = synthetic.hemisphere()
    lights, views = (DirectionMesh.from_directions(rows) for rows in (directions, directions[:-1]))
    shapes = {"grey": ((1,), (len(views.directions), 3)), "colour": ((3,), (len(views.directions),))}
    for channel, weights in shapes.values():
        maps = rng.uniform(0.2, 1.0, (rank, len(directions), 5, 7, *channel)).astype(np.float32)
        material = FactoredBtf(maps, rng.uniform(-0.2, 1.0, (rank, *weights)).astype(np.float32), lights, views)
        material = material if kind is None else material.coded(kind)
        assert gl_vs_reference(material, MESHES["torus"], size=(80, 80), renderer=gl) <= BOUND


def test_matt_material_is_albedo_times_cosine_over_pi():
    albedo = np.array([0.8, 0.5, 0.2])
    directions = synthetic.hemisphere()
    uv = np.random.default_rng(1).uniform(size=(len(directions), 2))
    value = outgoing(synthetic.lambertian(tuple(albedo)), uv, directions, directions[::-1])
    np.testing.assert_allclose(value, directions[:, 2:] * albedo / np.pi, rtol=1e-5, atol=1e-9)


def test_light_under_the_horizon_is_black(material):
    below = np.array([[0.6, 0.0, -0.8], [0.0, 1.0, 0.0]])
    view = np.tile([0.0, 0.0, 1.0], (2, 1))
    np.testing.assert_array_equal(outgoing(material, np.full((2, 2), 0.3), below, view), 0.0)


def test_repeating_map_meets_itself_at_every_border():
    material = repeating(synthetic.stone(24, 32, wrap=False))
    assert material.wrap
    assert material.residual.shape == (3, 48, 64, 3)
    assert repeating(material) is material
    for one, other in ((0, -1), (31, 32)):
        np.testing.assert_array_equal(material.residual[:, :, one], material.residual[:, :, other])
    for one, other in ((0, -1), (23, 24)):
        np.testing.assert_array_equal(material.residual[:, one], material.residual[:, other])


def test_relative_error_counts_small_values_against_the_peak():
    error = relative_error(np.array([1.001, 2e-6, 0.0]), np.array([1.0, 1e-6, 0.0]))
    np.testing.assert_allclose(error, [1e-3, 1e-3, 0.0], rtol=1e-9)


def test_what_is_no_material_is_refused(gl):
    with pytest.raises(MaterialError, match="these are: FactoredBtf, FlatTexture, Mesostructure, SbrdfPlus, Srf"):
        outgoing("plaster", np.zeros((1, 2)), np.zeros((1, 3)), np.zeros((1, 3)))
    with pytest.raises(MaterialError, match="str is not a material"):
        upload(gl.context, "plaster")


def test_material_with_too_many_maps_is_refused(gl, btf):
    room = gl.context.info["GL_MAX_ARRAY_TEXTURE_LAYERS"]
    rank = room // 18 + 4
    large = replace(btf, eigenmaps=np.zeros((rank, 25, 1, 1, 3), np.float32), weights=np.zeros((rank, 25), np.float32))
    with (
        gl.context,
        pytest.raises(MaterialError, match=rf"{-(-rank // 4) * 75} layers, the graphics library takes {room}"),
    ):
        upload(gl.context, large)


def test_material_of_another_number_of_channels_is_refused(gl, btf):
    with gl.context, pytest.raises(MaterialError, match="1 channels"):
        upload(gl.context, replace(btf, eigenmaps=btf.eigenmaps[..., :1]))


def _smallest_area(mesh: DirectionMesh) -> float:
    a, b, c = (mesh.directions[mesh.triangles[:, k], :2] for k in range(3))
    return float(np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).min())
