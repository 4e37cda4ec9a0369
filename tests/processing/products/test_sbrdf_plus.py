"""SBRDF+ in one texture and on disk: sizes, exactness, refusals."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.errors import ImageError
from processing.products import LafortuneTexels, SbrdfPlus, Srf
from processing.products.sbrdf_packing import TextureLayout, pack, unpack
from tests.reference.sbrdf_plus import lobes, product

SIDES = st.integers(1, 40)
COUNTS = st.integers(1, 90)
PRODUCTS = st.builds(
    product,
    seed=st.integers(0, 99),
    lights=st.integers(3, 12),
    views=st.integers(3, 12),
    height=st.integers(1, 9),
    width=st.integers(1, 300),
    centres=st.integers(0, 3),
    hidden=st.sampled_from([0.0, 0.3, 1.0]),
    shared=st.booleans(),
)
FEW = settings(max_examples=40, deadline=None)


def test_the_texture_is_the_papers():
    """16 maps in a row, 1024 x 512, and 1984 centres."""
    layout = TextureLayout(81, 81, 64, 64)
    assert layout.shape == (512, 1024)
    assert layout.centres == len(layout.centre_corners) == 1984
    assert layout.shift_steps == (256, 256)


@pytest.mark.parametrize(("shared", "size"), [(False, 2_490_368), (True, 2_359_296)])
def test_bytes_are_those_of_the_layouts(shared, size):
    assert product(lights=81, views=81, height=64, width=64, hidden=0, shared=shared).size_bytes == size


@FEW
@given(COUNTS, COUNTS, SIDES, SIDES)
def test_maps_and_centres_do_not_meet(lights, views, height, width):
    """Every texel of the texture has one use at most, every view a centre."""
    layout = TextureLayout(lights, views, height, width)
    uses = np.zeros(layout.shape, int)
    np.add.at(uses, (layout.map_rows, layout.map_columns), 1)
    rows, columns = layout.centre_corners.T
    np.add.at(uses, (rows[:, None] + np.arange(lights), columns[:, None]), 1)
    assert uses.max() == 1
    assert layout.centres >= views
    assert all(side & (side - 1) == 0 for side in layout.shape)


@FEW
@given(PRODUCTS)
def test_codes_lie_within_half_a_step(before):
    """Shadows 1/510; shifts half of 1/256 of the tile or finer, around it; centres half a step of the cube root."""
    after = before.quantised()
    np.testing.assert_allclose(after.shadow, before.shadow, atol=0.5 / 255 + 1e-6)
    np.testing.assert_array_equal(after.hidden, before.hidden)
    np.testing.assert_array_equal(after.cluster[after.hidden], before.cluster[before.hidden])
    tile = np.array(before.lobes.shape[::-1])
    steps = np.array(TextureLayout(3, 3, *before.lobes.shape).shift_steps)
    apart = (after.shift - before.shift)[~before.hidden] / tile
    assert (np.abs(apart - np.rint(apart)) <= 0.5 / steps + 1e-6).all()
    assert (steps >= 128).all() or (tile < 256).all()
    cosine = before.lights.directions[:, 2:]
    roots = np.cbrt(before.centres * cosine), np.cbrt(after.centres * cosine)
    # The scale is rounded to eleven bits, so the largest values may lie under it by a quarter of a step.
    np.testing.assert_allclose(roots[1], roots[0], atol=0.51 / 255 * roots[0].max(initial=0.0) + 1e-6)


@pytest.mark.parametrize("side", [1, 7, 64, 100, 129, 255, 256])
def test_whole_texels_are_exact(side):
    before = product(height=1, width=side, centres=0)
    whole = np.arange(before.shift[..., 0].size).reshape(before.shift.shape[:3]) % side
    exact = replace(before, shift=np.stack([whole, 0 * whole], axis=-1).astype(np.float32)).quantised()
    np.testing.assert_array_equal(exact.shift[..., 0] % side, whole)


@FEW
@given(PRODUCTS)
def test_packing_again_changes_nothing(before):
    once = before.packed()
    again = pack(unpack(once))
    np.testing.assert_array_equal(once.texture, again.texture)
    assert (once.scale, once.centres) == (again.scale, again.centres)


@pytest.mark.parametrize("factor", [1e-30, 1e-6, 1.0, 1e6, 1e30])
def test_centres_of_any_size_keep_their_codes(factor):
    before = product()
    other = replace(before, centres=before.centres * np.float32(factor))
    off = np.abs(other.packed().texture.astype(int) - before.packed().texture).max()
    assert off <= 1  # the scale is rounded in other places
    np.testing.assert_array_equal(pack(unpack(other.packed())).texture, other.packed().texture)


def test_missing_values_are_lit_still_and_black():
    before = product()
    before.shadow[0, 0, 0], before.shift[0, 0, 0], before.centres[0, 0] = np.nan, np.nan, np.nan
    before.hidden[0, 0, 0] = False
    after = before.quantised()
    assert after.shadow[0, 0, 0] == 1
    assert (after.shift[0, 0, 0] == 0).all()
    assert (after.centres[0, 0] == 0).all()


def test_centres_that_do_not_fit_are_refused():
    room = TextureLayout(9, 7, 6, 10).centres
    with pytest.raises(ImageError, match=f"room for {room}"):
        product(centres=room + 1).packed()
    with pytest.raises(ImageError, match="beyond the 5 that there are"):
        replace(product(), centres=product().centres[:5]).packed()


def files_of(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("shared", [False, True])
def test_what_was_loaded_is_saved_as_the_same_bytes(tmp_path, shared):
    fine = replace(product(shared=shared), coarser=(product(1, height=3, width=5), product(2, height=1, width=2)))
    fine.save(tmp_path / "once")
    SbrdfPlus.load(tmp_path / "once").save(tmp_path / "again")
    assert files_of(tmp_path / "once") == files_of(tmp_path / "again")
    assert len(files_of(tmp_path / "once")) == 9


def test_a_loaded_product_is_the_quantised_one(tmp_path):
    before = product()
    before.save(tmp_path)
    after, told = SbrdfPlus.load(tmp_path), before.quantised()
    for name in ("shadow", "shift", "hidden", "cluster", "centres"):
        np.testing.assert_array_equal(getattr(after, name), getattr(told, name))
        assert getattr(after, name).dtype == getattr(before, name).dtype
    for name in ("diffuse", "axis", "exponent", "albedo"):
        np.testing.assert_array_equal(getattr(after.lobes, name), getattr(before.lobes, name))
    assert after.provenance == before.provenance


@pytest.mark.parametrize("name", ["sbrdf_plus.png", "sbrdf_plus.npz", "level_1/sbrdf_plus.png", "level_1/product.json"])
@pytest.mark.parametrize("damage", ["missing", "cut", "altered", "another"])
def test_a_damaged_folder_is_named(tmp_path, name, damage):
    folder = tmp_path / "product"
    replace(product(), coarser=(product(1),)).save(folder)
    path = folder / name
    content = bytearray(path.read_bytes())
    if damage == "missing":
        path.unlink()
    elif damage == "cut":
        path.write_bytes(content[: len(content) // 2])
    elif damage == "altered":
        middle = len(content) // 2
        path.write_bytes(
            content[:middle] + bytes(255 - byte for byte in content[middle : middle + 8]) + content[middle + 8 :]
        )
    else:
        product(2, lights=5, height=4).save(tmp_path / "other")
        path.write_bytes((tmp_path / "other" / name.removeprefix("level_1/")).read_bytes() + b"}")
    with pytest.raises(ImageError, match=str(folder)):
        SbrdfPlus.load(folder)


def test_other_products_are_refused_by_name(tmp_path):
    product().save(tmp_path)
    with pytest.raises(ImageError, match="expected a srf"):
        Srf.load(tmp_path)
    with pytest.raises(ImageError, match="nowhere"):
        SbrdfPlus.load(tmp_path / "nowhere")


@FEW
@given(SIDES, SIDES, st.integers(0, 4), st.booleans(), st.integers(0, 99))
def test_lobes_come_back_from_their_floats(height, width, count, shared, seed):
    before = lobes(height, width, np.random.default_rng(seed), count=max(count, 1), shared=shared)
    packed = before.packed()
    assert packed.shape[2] == (4 + 4 * before.lobes if before.shared else 3 + 7 * before.lobes)
    assert packed.shape[2] <= 3 + 7 * before.lobes
    after = LafortuneTexels.unpacked(packed, before.lobes)
    for name in ("diffuse", "axis", "exponent", "albedo"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))


def test_floats_of_other_lobes_are_refused():
    with pytest.raises(ImageError, match="24 or 16"):
        LafortuneTexels.unpacked(np.zeros((2, 2, 20), np.float32), 3)


def test_evaluation_after_packing_differs_by_the_codes():
    """At measured directions and texels' middles, where nothing is interpolated; shifts of whole texels are exact."""
    wide = product(views=5, width=16, height=8)
    before = replace(wide, shift=np.rint(wide.shift))
    uv = (np.stack(np.meshgrid(np.arange(16), np.arange(8)), axis=-1).reshape(-1, 2) + 0.5) / (16, 8)
    ways = [np.broadcast_to(d, (len(uv), 3)) for d in (before.lights.directions[4], before.views.directions[2])]
    apart = np.abs(before.quantised().evaluate(uv, *ways) - before.evaluate(uv, *ways))
    lit = replace(before, shadow=np.ones_like(before.shadow)).evaluate(uv, *ways)
    brightest = (before.centres * before.lights.directions[:, 2:]).max()
    # Half a code: of the shadow, and of the cube root, whose cube is three times as steep at its brightest.
    assert apart.max() <= 0.5 / 255 * lit.max() + 3 * 0.51 / 255 * brightest + 1e-6
