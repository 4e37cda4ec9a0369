"""MERL files: values are where a lookup by angles finds them, missing ones are filled, other files are refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.errors import ImageError
from processing.formats.merl import CELLS, read_merl
from processing.lighting import brdfs
from tests.public_data import DATA
from tests.reference.merl import angles_of, cells_of, directions_of, looked_up, write_merl

GGX = brdfs.ggx(np.array([0.3, 0.2, 0.1]), np.array([0.9, 0.5, 0.1]), 0.6)


def pairs(count, seed):
    rng = np.random.default_rng(seed)
    way = rng.normal(size=(2, count, 3))
    way[..., 2] = np.abs(way[..., 2])
    way /= np.linalg.norm(way, axis=-1, keepdims=True)
    high = (way[..., 2] > 0.25).all(axis=0)
    return way[0, high], way[1, high]


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    path = tmp_path_factory.mktemp("merl") / "ggx.binary"
    write_merl(path, cells_of(GGX))
    return path


@given(st.integers(0, 1000))
@settings(max_examples=5, deadline=None)
def test_angles_of_the_reference_are_those_of_its_directions(seed):
    light, view = pairs(50, seed)
    one, two = directions_of(*angles_of(light, view))
    # But for a turn about the normal, which isotropic surfaces do not know.
    assert np.allclose(one[:, 2], light[:, 2])
    assert np.allclose((one * two).sum(axis=1), (light * view).sum(axis=1))


def test_a_file_gives_the_reflectance_that_it_was_made_of(written):
    """Cells are a degree wide: the lobe of roughness 0.6 is linear over one to a few thousandths."""
    light, view = pairs(4000, 1)
    found = brdfs.tabulated(read_merl(written).table).evaluate(light, view)
    assert np.allclose(found, GGX.evaluate(light, view), rtol=0.01)


def test_a_file_of_noise_is_read_cell_by_cell_as_the_published_reader_does(tmp_path):
    """What is mirrored by itself comes back in the cells' middles, to the rounding of cosines of tiny angles."""
    rng = np.random.default_rng(2)
    values = rng.uniform(0.1, 1, (*CELLS, 3))
    values = (values + values[:, :, ::-1]) / 2
    write_merl(tmp_path / "noise.binary", values)
    found = brdfs.tabulated(read_merl(tmp_path / "noise.binary").table)
    cell = rng.integers(0, CELLS, (500, 3))
    half, difference, azimuth = ((cell + 0.5) / CELLS * [1, np.pi / 2, np.pi]).T
    light, view = directions_of(half**2 * np.pi / 2, difference, azimuth)
    above = np.minimum(light[:, 2], view[:, 2]) > 1e-6
    assert above.sum() > 100
    light, view = light[above], view[above]
    assert np.allclose(found.evaluate(light, view), looked_up(values, light, view), atol=0.01)


def test_the_azimuth_of_the_light_about_the_half_vector_counts(written):
    """A mean over it, as of tables of two angles, is off where eye or light are low."""
    light, view = pairs(4000, 3)
    table = read_merl(written).table
    mean = brdfs.tabulated(np.broadcast_to(table.mean(axis=2, keepdims=True), table.shape))
    truth = GGX.evaluate(light, view)
    apart = [np.abs(brdf.evaluate(light, view) - truth).mean() for brdf in (brdfs.tabulated(table), mean)]
    assert apart[0] < 0.05 * apart[1]


def test_cells_without_a_value_take_the_mirrored_or_the_nearest_one(tmp_path):
    values = cells_of(GGX)
    full = values.copy()
    values[10:14, 20:24, 30:34] = -1  # its mirror image is there
    values[40, 10, [50, 129]] = np.nan  # nothing but neighbours
    write_merl(tmp_path / "holes.binary", values)
    found = read_merl(tmp_path / "holes.binary")
    assert np.allclose(found.table[10:14, 20:24, 30:34], full[10:14, 20:24, 30:34])
    assert np.allclose(found.table[40, 10, 50], full[40, 10, 50], rtol=0.1)
    assert found.missing == pytest.approx(1 / 5e5, rel=0.5)
    assert (found.table > 0).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda content: content[:8], "instead of 90, 90, 180"),
        (lambda content: b"\x10" + content[1:], "instead of 90, 90, 180"),
        (lambda content: content[:-8], "copy it again"),
        (lambda content: content[:12] + b"\xff" * (len(content) - 12), "no cell holds a value"),  # NaN throughout
    ],
)
def test_other_files_are_refused(written, tmp_path, change, message):
    path = tmp_path / "bad.binary"
    path.write_bytes(change(written.read_bytes()))
    with pytest.raises(ImageError, match=message):
        read_merl(path)
    with pytest.raises(ImageError, match="not a readable MERL file"):
        read_merl(tmp_path / "absent.binary")


def test_real_files_are_whole_and_reflect_no_more_than_they_get():
    paths = sorted(DATA.rglob("*.binary"))
    if not paths:
        pytest.skip("shared/data holds no MERL file (*.binary)")
    for path in paths:
        found = read_merl(path)
        assert found.missing < 0.5, path
        light, view = pairs(20_000, 4)
        assert (brdfs.tabulated(found.table).evaluate(light, view).mean(axis=0) < 2).all(), path
