import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.errors import ImageError
from processing.products import (
    AnisotropicPhong,
    BlinnPhong,
    Btf,
    DirectionMesh,
    FactoredBtf,
    Mdf,
    Provenance,
    ReflectanceMaps,
    ResidualBasis,
    Srf,
    StoredBtf,
    bilinear_taps,
    half_vectors,
    unpack8,
)

LOBE = BlinnPhong(np.array([0.3, 0.2, 0.1]), np.array([0.1, 0.2, 0.3]), 12.0)
MADE_FROM = Provenance(("tt+000_arc+030_lamp3",), "calibration 7", {"rank": 4})


def test_lobe_is_the_sum_of_its_two_terms():
    """Straight above: N.L = N.H = 1. Light under the horizon: nothing, whatever the half vector."""
    up, low = np.array([[0.0, 0.0, 1.0]]), np.array([[np.sqrt(0.99), 0.0, -0.1]])
    np.testing.assert_allclose(LOBE.evaluate(up, up)[0], LOBE.diffuse + LOBE.specular)
    assert (LOBE.evaluate(low, up) == 0).all()
    slanted = np.array([[0.6, 0.0, 0.8]])
    np.testing.assert_allclose(LOBE.evaluate(slanted, up)[0], 0.8 * LOBE.diffuse + 0.9**6 * LOBE.specular)


@given(st.floats(0, 3.1), st.floats(0, 6.3))
def test_half_vector_halves_the_angle_however_wide(apart, azimuth):
    light = np.array([[np.sin(apart) * np.cos(azimuth), np.sin(apart) * np.sin(azimuth), np.cos(apart)]])
    view = np.array([[0.0, 0.0, 1.0]])
    half = half_vectors(light, view)
    np.testing.assert_allclose(np.linalg.norm(half), 1, atol=1e-9)
    np.testing.assert_allclose([half[0] @ light[0], half[0, 2]], np.cos(apart / 2), atol=1e-9)


def test_lobe_has_no_hole_where_light_and_view_are_opposite():
    """H is undefined there and counts as N.H = 0."""
    light = np.array([[0.6, 0.0, 0.8]])
    np.testing.assert_allclose(LOBE.evaluate(light, -light)[0], 0.8 * LOBE.diffuse)


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 9), st.integers(1, 9), st.booleans(), st.integers(0, 2**32 - 1))
def test_bilinear_weights_are_a_partition_and_exact_at_centres(height, width, wrap, seed):
    rng = np.random.default_rng(seed)
    rows, columns, weights = bilinear_taps(rng.uniform(-2, 3, (50, 2)), height, width, wrap=wrap)
    assert (weights >= 0).all()
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-12)
    assert rows.min() >= 0
    assert rows.max() < height
    assert columns.min() >= 0
    assert columns.max() < width
    y, x = np.mgrid[:height, :width]
    centres = np.stack([(x.ravel() + 0.5) / width, (y.ravel() + 0.5) / height], axis=1)
    rows, columns, weights = bilinear_taps(centres, height, width, wrap=wrap)
    texture = rng.normal(size=(height, width))
    np.testing.assert_allclose((texture[rows, columns] * weights).sum(axis=1), texture.ravel(), atol=1e-9)


def test_repeating_texture_repeats(rng):
    texture, uv = rng.normal(size=(5, 7)), rng.uniform(0, 1, (100, 2))

    def look_up(at):
        rows, columns, weights = bilinear_taps(at, 5, 7, wrap=True)
        return (texture[rows, columns] * weights).sum(axis=1)

    np.testing.assert_allclose(look_up(uv), look_up(uv + np.array([3, -2])), atol=1e-9)


def test_directions_on_a_line_are_refused(hemisphere):
    line = np.stack([np.linspace(-0.9, 0.9, 5), np.zeros(5), np.sqrt(1 - np.linspace(-0.9, 0.9, 5) ** 2)], axis=1)
    for directions in (line, hemisphere[:2]):
        with pytest.raises(ImageError, match="span"):
            DirectionMesh.from_directions(directions)


def test_srf_is_lobe_plus_residual_times_half_vector(rng):
    residual = rng.normal(size=(3, 4, 5, 3)).astype(np.float32)
    srf = Srf(residual, LOBE, wrap=False)
    up = np.array([[0.0, 0.0, 1.0]])
    value = srf.evaluate(np.array([[2.5 / 5, 1.5 / 4]]), up, up)
    np.testing.assert_allclose(value[0], LOBE.evaluate(up, up)[0] + residual[:, 1, 2, 2], rtol=1e-6)
    assert (srf.evaluate(np.array([[0.5, 0.5]]), -up, up) == 0).all()


def test_undetermined_texels_are_the_lobe_alone():
    up = np.array([[0.0, 0.0, 1.0]])
    srf = Srf(np.full((3, 2, 2, 3), np.nan, np.float32), LOBE, wrap=True)
    np.testing.assert_allclose(srf.evaluate(np.array([[0.3, 0.3]]), up, up), LOBE.evaluate(up, up))


def test_srf_comes_back_from_one_packed_image(tmp_path, rng):
    srf = Srf(rng.normal(size=(3, 6, 4, 3)).astype(np.float32), LOBE, True, MADE_FROM)
    srf.residual[0, 0, 0] = np.nan
    srf.save(tmp_path / "srf")
    back = Srf.load(tmp_path / "srf")
    np.testing.assert_array_equal(back.residual, srf.residual)
    assert back.packed().shape == (6, 12, 3)
    assert back.wrap
    assert back.provenance == MADE_FROM
    assert back.phong.exponent == LOBE.exponent


@pytest.mark.parametrize("basis", ResidualBasis)
def test_srf_over_any_basis_comes_back(tmp_path, rng, basis):
    lobe = AnisotropicPhong(LOBE.diffuse, LOBE.specular, np.array([10.0, 90.0]), 0.4)
    srf = Srf(rng.normal(size=(3, 6, 4, basis.size)).astype(np.float32), lobe, False, MADE_FROM, basis)
    srf.save(tmp_path / "srf")
    back = Srf.load(tmp_path / "srf")
    assert back.basis is basis
    np.testing.assert_array_equal(back.residual, srf.residual)
    assert back.phong.as_dict() == lobe.as_dict()


def test_srf_whose_coefficients_are_not_of_its_basis_is_refused():
    with pytest.raises(ImageError, match=r"over half_light is \(3, y, x, 5\)"):
        Srf(np.zeros((3, 2, 2, 3), np.float32), LOBE, wrap=True, basis=ResidualBasis.HALF_LIGHT)


def test_harmonics_are_orthonormal_over_the_hemisphere():
    height, azimuth = np.meshgrid((np.arange(400) + 0.5) / 400, 2 * np.pi * np.arange(64) / 64)
    level = np.sqrt(1 - height**2)
    light = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), height], axis=-1).reshape(-1, 3)
    values = ResidualBasis.HEMISPHERICAL.evaluate(light, light)
    np.testing.assert_allclose(2 * np.pi * values.T @ values / len(light), np.eye(9), atol=1e-4)


def test_bilinear_functions_trade_places_with_light_and_view(hemisphere):
    """Any matrix S makes L . S V of them, and the transposed one the same with light and view exchanged."""
    view, form = hemisphere[::-1], np.arange(9.0).reshape(3, 3) ** 2
    there, back = (ResidualBasis.BILINEAR.evaluate(*ways) for ways in ((hemisphere, view), (view, hemisphere)))
    np.testing.assert_allclose(there @ form.ravel(), np.einsum("ni,ij,nj->n", hemisphere, form, view))
    np.testing.assert_allclose(there @ form.ravel(), back @ form.T.ravel())


@pytest.mark.parametrize("turn_rad", [0.0, 0.7, -2.0])
def test_equal_exponents_are_the_round_lobe(hemisphere, turn_rad):
    round_lobe = BlinnPhong(LOBE.diffuse, LOBE.specular, 30.0)
    drawn_out = AnisotropicPhong(LOBE.diffuse, LOBE.specular, np.array([30.0, 30.0]), turn_rad)
    view = hemisphere[::-1]
    np.testing.assert_allclose(drawn_out.evaluate(hemisphere, view), round_lobe.evaluate(hemisphere, view), rtol=1e-9)


def test_anisotropic_lobe_is_broad_where_its_exponent_is_small():
    lobe = AnisotropicPhong(np.zeros(3), np.ones(3), np.array([5.0, 500.0]), np.pi / 2)
    up, tilt = np.array([[0.0, 0.0, 1.0]]), np.radians(30.0)
    along_b, along_t = (np.array([[np.sin(tilt) * t, np.sin(tilt) * b, np.cos(tilt)]]) for t, b in ((0, 1), (1, 0)))
    np.testing.assert_allclose(lobe.evaluate(along_b, up), np.cos(tilt / 2) ** 5, rtol=1e-12)
    np.testing.assert_allclose(lobe.evaluate(along_t, up), np.cos(tilt / 2) ** 500, rtol=1e-12)


def test_factored_btf_comes_back_and_evaluates_the_same(tmp_path, rng, hemisphere):
    mesh = DirectionMesh.from_directions(hemisphere)
    maps = rng.random((2, 40, 4, 5, 3)).astype(np.float32)
    btf = FactoredBtf(maps, rng.random((2, 40)).astype(np.float32), mesh, mesh, MADE_FROM)
    btf.save(tmp_path)
    back = FactoredBtf.load(tmp_path)
    uv, light, view = rng.random((20, 2)), hemisphere[:20], hemisphere[20:]
    np.testing.assert_array_equal(back.evaluate(uv, light, view), btf.evaluate(uv, light, view))
    assert back.provenance == MADE_FROM


def test_factored_btf_is_the_sum_of_products(rng):
    """Three directions make one triangle, whose corners are met exactly."""
    corners = np.array([[0.6, 0.0, 0.8], [-0.6, 0.1, np.sqrt(0.63)], [0.0, 0.6, 0.8]])
    mesh = DirectionMesh.from_directions(corners)
    maps, weights = rng.random((2, 3, 4, 4, 3)).astype(np.float32), rng.random((2, 3)).astype(np.float32)
    btf = FactoredBtf(maps, weights, mesh, mesh)
    value = btf.evaluate(np.array([[1.5 / 4, 2.5 / 4]]), corners[1:2], corners[2:3])
    np.testing.assert_allclose(value[0], np.einsum("kc,k->c", maps[:, 1, 2, 1], weights[:, 2]), rtol=1e-6)


def test_btf_on_disk_is_read_whole_by_image_and_by_texel(tmp_path, rng):
    directions = rng.normal(size=(11, 3))
    reflectance = rng.random((9, 11, 20, 18, 3)).astype(np.float32)
    reflectance[0, 0, 0, 0] = np.nan
    Btf(reflectance, directions[:9], directions, MADE_FROM).save(tmp_path)
    # float16 keeps 11 bits: half a step of values under 1 is 2^-12.
    np.testing.assert_allclose(Btf.load(tmp_path).reflectance, reflectance, atol=2**-12)
    stored = StoredBtf.open(tmp_path)
    np.testing.assert_allclose(stored.image(3, 8), reflectance[3, 8], atol=2**-12)
    np.testing.assert_allclose(stored.texel(19, 2), reflectance[:, :, 19, 2], atol=2**-12)
    assert stored.provenance == MADE_FROM
    np.testing.assert_array_equal(stored.light_directions, directions[:9])


def test_btf_beyond_float16_is_refused_not_clipped(tmp_path):
    with pytest.raises(ImageError, match="float16"):
        Btf(np.full((1, 1, 1, 1, 3), 1e5, np.float32), np.eye(3)[:1], np.eye(3)[:1]).save(tmp_path)


@settings(max_examples=30, deadline=None)
@given(st.floats(1e-9, 1e3), st.integers(0, 2**32 - 1))
def test_packed_mdf_is_within_half_a_step(deepest, seed):
    rng = np.random.default_rng(seed)
    displacement = (rng.random((2, 5, 6)) * deepest).astype(np.float32)
    displacement[0, 1] = np.nan
    mdf = Mdf(displacement, displacement, np.eye(3)[:2], 0.06)
    code, scale_m = mdf.pack8()
    back = unpack8(code, scale_m)
    np.testing.assert_array_equal(np.isnan(back), np.isnan(displacement))
    assert np.nanmax(np.abs(back - displacement)) <= scale_m * 0.5001


def test_mdf_without_any_measurement_packs_to_missing():
    mdf = Mdf(np.full((1, 2, 2), np.nan, np.float32), np.full((1, 2, 2), np.nan, np.float32), np.eye(3)[:1], 0.06)
    assert np.isnan(unpack8(*mdf.pack8())).all()


def test_mdf_and_reflectance_maps_come_back(tmp_path, rng):
    mdf = Mdf(*rng.random((2, 2, 4, 4)).astype(np.float32), np.eye(3)[:2], 0.06, MADE_FROM)
    mdf.save(tmp_path / "mdf")
    back = Mdf.load(tmp_path / "mdf")
    np.testing.assert_array_equal(back.displacement_m, mdf.displacement_m)
    assert (back.side_m, back.provenance) == (0.06, MADE_FROM)
    maps = ReflectanceMaps(*rng.random((2, 3, 4, 4, 3)).astype(np.float32), np.eye(3), np.full(3, np.inf), 22.0)
    maps.save(tmp_path / "maps")
    again = ReflectanceMaps.load(tmp_path / "maps")
    np.testing.assert_array_equal(again.reflectance_cos, maps.reflectance_cos)
    np.testing.assert_array_equal(again.light_distances, maps.light_distances)


def test_a_folder_with_something_else_is_named(tmp_path, rng):
    Srf(rng.normal(size=(3, 2, 2, 3)).astype(np.float32), LOBE, wrap=True).save(tmp_path)
    with pytest.raises(ImageError, match="expected a mdf of schema 1, found srf"):
        Mdf.load(tmp_path)
    (tmp_path / "product.json").write_text(json.dumps({"kind": "srf"}))
    with pytest.raises(ImageError, match="not the description of a product"):
        Srf.load(tmp_path)
    with pytest.raises(ImageError, match="not the description of a product"):
        Srf.load(tmp_path / "nowhere")


def damaged(path):
    """The file gone, cut in the middle, empty, or another file altogether."""
    content = path.read_bytes()
    yield path.unlink()
    for other in (content[: len(content) // 2], content[:-20], b"", b"hello"):
        yield path.write_bytes(other)


def test_a_damaged_file_of_a_product_is_named(tmp_path, rng, hemisphere):
    mesh = DirectionMesh.from_directions(hemisphere[:5])
    cube = rng.random((2, 3, 4, 4, 3)).astype(np.float32)
    products = {
        "srf.exr": Srf(rng.normal(size=(3, 20, 20, 3)).astype(np.float32), LOBE, wrap=True),
        "mdf.npz": Mdf(*cube[:, :, :, :, 0], np.eye(3), 0.06),
        "reflectance_maps.npz": ReflectanceMaps(*cube, np.eye(3), np.full(3, np.inf), 22.0),
        "factors.npz": FactoredBtf(rng.random((1, 5, 2, 2, 3)), rng.random((1, 5)), mesh, mesh),
        "directions.npz": Btf(rng.random((5, 5, 2, 2, 3)).astype(np.float32), hemisphere[:5], hemisphere[:5]),
    }
    for name, product in products.items():
        folder = tmp_path / name
        product.save(folder)
        for _ in damaged(folder / name):
            with pytest.raises(ImageError, match=name):
                type(product).load(folder)


def test_a_shard_that_got_lost_is_not_measured_rather_than_black(tmp_path, rng):
    directions = rng.normal(size=(9, 3))
    Btf(rng.random((9, 9, 4, 4, 3)).astype(np.float32) + 0.1, directions, directions).save(tmp_path)
    (tmp_path / "btf.zarr" / "c" / "1" / "0" / "0" / "0" / "0").unlink()
    lost = np.zeros((9, 9), bool)
    lost[8:, :8] = True
    back = Btf.load(tmp_path).reflectance
    np.testing.assert_array_equal(np.isnan(back), np.broadcast_to(lost[..., None, None, None], back.shape))


def test_a_btf_without_its_store_is_named(tmp_path, rng, hemisphere):
    Btf(rng.random((5, 5, 2, 2, 3)).astype(np.float32), hemisphere[:5], hemisphere[:5]).save(tmp_path)
    store = tmp_path / "btf.zarr"
    (store / "zarr.json").write_text("{")
    with pytest.raises(ImageError, match=r"btf\.zarr"):
        StoredBtf.open(tmp_path)
    store.rename(tmp_path / "elsewhere")
    with pytest.raises(ImageError, match=r"btf\.zarr"):
        StoredBtf.open(tmp_path)


def test_description_says_versions_and_origin(tmp_path, rng):
    Srf(rng.normal(size=(3, 2, 2, 3)).astype(np.float32), LOBE, True, MADE_FROM).save(tmp_path)
    description = json.loads((tmp_path / "product.json").read_text())
    assert description["versions"]["numpy"] == np.__version__
    assert description["provenance"]["calibration"] == "calibration 7"
