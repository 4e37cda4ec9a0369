"""A skin covers any mesh, keeps what the example has, and shows no chart's border."""

from dataclasses import replace

import numpy as np
import pytest

from processing.errors import ImageError
from processing.materials.skin import SkinOptions, drape
from processing.products import BlinnPhong, ResidualBasis, Srf, bilinear_taps
from tests.reference.skin import ball, cylinder
from tests.render.synthetic import stone

LOBE = BlinnPhong(np.array([0.1, 0.1, 0.1]), np.array([0.2, 0.2, 0.2]), 20.0)
BALL = ball()
COARSE = SkinOptions(width=2.0, size=160, seed=3)


def uniform(vector, basis=ResidualBasis.HALF):
    residual = np.broadcast_to(np.asarray(vector, np.float32), (3, 40, 40, basis.size)).copy()
    return Srf(residual, LOBE, True, basis=basis)


def sampled(skin, corners, weights):
    """Residuals (n, 3, k) at places in triangles, as a renderer looks them up, and the patches (n, 4) that it finds."""
    uv = np.einsum("nk,nkc->nc", weights, skin.uv[skin.triangles[corners]])
    rows, columns, taps = bilinear_taps(uv, *skin.srf.residual.shape[1:3], wrap=True)
    made = np.einsum("nt,cnti->nci", taps, skin.srf.residual[:, rows, columns].astype(np.float64))
    return made, np.where(taps > 1e-6, skin.patch[rows, columns], 0)


def anywhere(rng, skin, count=4000):
    return sampled(skin, rng.integers(len(skin.triangles), size=count), rng.dirichlet(np.ones(3), count))


@pytest.fixture(scope="module")
def skin():
    return drape(stone(48, 48), *BALL, COARSE)


def test_every_lookup_finds_texels_that_were_made(rng, skin):
    """Inside triangles, at their edges and at their corners."""
    _, patches = anywhere(rng, skin)
    assert (patches >= 0).all()
    for weights in (np.eye(3)[0], np.array([0.5, 0.5, 0.0])):
        triangles = np.arange(len(skin.triangles))
        _, patches = sampled(skin, triangles, np.broadcast_to(weights, (len(triangles), 3)))
        assert (patches >= 0).all()


def test_what_is_the_same_all_over_stays_so(rng):
    """Patches, cuts and gutters add nothing: the normal's part is untouched by any turn."""
    made, _ = anywhere(rng, drape(uniform([0, 0, 0.3]), *BALL, COARSE))
    np.testing.assert_allclose(made[..., 2], 0.3, atol=1e-5)
    np.testing.assert_allclose(made[..., :2], 0.0, atol=1e-5)


@pytest.mark.parametrize("basis", ResidualBasis)
def test_every_basis_goes_along(rng, basis):
    """A function without azimuth has the same value on any patch, however that is turned."""
    constant = np.zeros(basis.size)
    constant[{"half": 2, "half_light": 3, "biquadratic": 0, "hemispherical": 2, "bilinear": 8}[basis]] = 0.2
    made, _ = anywhere(rng, drape(uniform(constant, basis), *cylinder(6, 12), COARSE), 500)
    np.testing.assert_allclose(made, np.broadcast_to(constant, made.shape), atol=1e-5)


def test_residual_along_t_lies_along_the_tangents(rng):
    """On a cylinder patches follow the field, which is level there, without a turn."""
    positions, normals, triangles = cylinder()
    skin = drape(uniform([0.3, 0, 0]), positions, normals, triangles, COARSE)
    level = np.cross([0, 0, 1], normals[skin.vertex])
    assert np.degrees(np.arccos(np.clip(np.sum(skin.tangents * level, axis=1), -1, 1))).max() < 3
    made, _ = anywhere(rng, skin)
    np.testing.assert_allclose(made[..., 0], 0.3, atol=0.01)


def test_triangle_without_area_or_normal_turns_nothing_else():
    """As scans have them: three corners at one place, where no triangle says which way is out."""
    positions, normals, triangles = cylinder()
    speck = np.full((1, 3), len(positions), np.int32)
    more = np.concatenate([positions, [[0, 0, 1.0]]]), np.concatenate([normals, np.zeros((1, 3))])
    skin = drape(uniform([0.3, 0, 0]), *more, np.concatenate([triangles, speck]), COARSE)
    own = skin.vertex < len(positions)
    level = np.cross([0, 0, 1], normals[skin.vertex[own]])
    assert np.degrees(np.arccos(np.clip(np.sum(skin.tangents[own] * level, axis=1), -1, 1))).max() < 3
    assert np.isfinite(skin.tangents).all()


def test_histogram_is_the_examples(rng, skin):
    """Mean and deviation of each coefficient of n, which no turn mixes: to 0.3 and 0.2 of the deviation."""
    example = stone(48, 48).residual[..., 2].reshape(3, -1)
    made, _ = anywhere(rng, skin)
    spread = example.std(axis=1)
    np.testing.assert_allclose(made[..., 2].mean(axis=0), example.mean(axis=1), atol=0.3 * spread.max())
    np.testing.assert_allclose(made[..., 2].std(axis=0) / spread, 1.0, atol=0.2)


def test_same_seed_same_skin_other_seed_another(skin):
    again = drape(stone(48, 48), *BALL, COARSE)
    np.testing.assert_array_equal(again.srf.residual, skin.srf.residual)
    other = drape(stone(48, 48), *BALL, replace(COARSE, seed=4))
    assert np.abs(other.srf.residual - skin.srf.residual).max() > 0.01


@pytest.mark.parametrize("scale", [2.0**-20, 2.0**20])
def test_size_of_the_mesh_does_not_matter(scale, skin):
    """About 1e-6 and 1e6, powers of two so that rounding is the same."""
    positions, normals, triangles = BALL
    made = drape(stone(48, 48), scale * positions, normals, triangles, replace(COARSE, width=scale * COARSE.width))
    np.testing.assert_array_equal(made.srf.residual, skin.srf.residual)


def test_brightness_only_scales_the_skin(skin):
    example = stone(48, 48)
    bright = drape(replace(example, residual=example.residual * np.float32(2**20)), *BALL, COARSE)
    peak = np.abs(skin.srf.residual).max()
    same = np.abs(bright.srf.residual / 2**20 - skin.srf.residual) < 1e-3 * peak
    assert same.mean() > 0.999


def test_undetermined_texels_that_no_patch_can_avoid_count_as_nothing():
    example = uniform([0, 0, 0.3])
    example.residual[:, ::7] = np.nan
    made = drape(example, *cylinder(6, 12), COARSE)
    assert np.isfinite(made.srf.residual).all()
    seen = made.srf.residual[..., 2][:, made.patch >= 0]
    assert -1e-6 < seen.min() < 0.1 < 0.2 < seen.max() < 0.3 + 1e-6


def test_background_of_a_sample_is_left_out(rng):
    """What a body does not cover of its picture has no residual: no patch shows that."""
    example = replace(uniform([0, 0, 0.3]), wrap=False)
    y, x = np.mgrid[:40, :40] - 19.5
    example.residual[:, np.hypot(x - 3, y) > 14] = np.nan
    made, _ = anywhere(rng, drape(example, *cylinder(6, 12), COARSE))
    np.testing.assert_allclose(made[..., 2], 0.3, atol=1e-5)


def test_a_material_without_any_residual_can_be_worn():
    made = drape(uniform([0, 0, 0]), *cylinder(6, 12), COARSE)
    assert (made.srf.residual == 0).all()


def test_map_that_ends_is_not_read_across_its_borders(rng):
    """Its left half is dark and its right half bright: only across the border would they meet in one texel."""
    residual = np.zeros((3, 64, 64, 3), np.float32)
    residual[..., 2] = np.linspace(0.0, 1.0, 64)
    example = Srf(residual, LOBE, wrap=False)
    positions, normals, triangles = cylinder()
    made = drape(example, positions, normals, triangles, COARSE)
    texture, patch = made.srf.residual[0, ..., 2], made.patch
    inside = (patch[:, 1:] == patch[:, :-1]) & (patch[:, 1:] >= 0)
    step = np.abs(np.diff(texture, axis=1))[inside]
    assert np.quantile(step, 0.98) < 0.2


@pytest.mark.parametrize("case", ["open", "two parts", "sheet with two sides", "unused vertices", "one triangle"])
def test_meshes_of_all_kinds_are_covered(rng, case):
    positions, normals, triangles = cylinder(4, 12)
    match case:
        case "two parts":
            positions = np.concatenate([positions, positions + np.array([5, 0, 0])])
            normals = np.concatenate([normals, normals])
            triangles = np.concatenate([triangles, triangles + len(positions) // 2]).astype(np.int32)
        case "sheet with two sides":
            triangles = np.concatenate([triangles, triangles[:, ::-1] + len(positions)]).astype(np.int32)
            positions, normals = np.concatenate([positions, positions]), np.concatenate([normals, -normals])
        case "unused vertices":
            positions = np.concatenate([positions, [[0, 0, 9.0]]])
            normals = np.concatenate([normals, [[0, 0, 1.0]]])
        case "one triangle":
            triangles = triangles[:1]
    skin = drape(stone(40, 40), positions, normals, triangles, COARSE)
    made, patches = anywhere(rng, skin, 1000)
    assert (patches >= 0).all()
    assert np.isfinite(made).all()
    np.testing.assert_allclose(np.linalg.norm(skin.tangents, axis=1), 1.0, atol=1e-9)


def test_mesh_without_area_and_sample_without_texels_are_refused():
    positions, normals, triangles = cylinder(4, 12)
    with pytest.raises(ImageError, match="no area"):
        drape(stone(40, 40), np.zeros_like(positions), normals, triangles, COARSE)
    with pytest.raises(ImageError, match="draw it wider or the texture finer"):
        drape(stone(40, 40), positions, normals, triangles, SkinOptions(width=0.1, size=160))
