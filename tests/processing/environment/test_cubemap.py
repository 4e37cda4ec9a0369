"""Cubemaps and panoramas: geometry, the integral over the sphere, files, and values that are no light."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.environment.equirectangular import (
    Panorama,
    cubemap_of,
    panorama_of,
    read_environment,
    write_panorama,
)
from processing.environment.repair import repair
from processing.errors import ImageError
from processing.formats.exr import ExrImage, read_exr, write_exr
from processing.products import Environment
from processing.products.light_environment import cube_directions, cube_places, cube_solid_angles, cube_taps
from render.environment import Environment as RenderEnvironment
from tests.public_data import DATA

SIZES = st.integers(1, 12)


def integral(panorama):
    return panorama.solid_angles @ panorama.radiance


@given(SIZES)
def test_texels_share_the_sphere_and_their_directions_find_them(size):
    assert cube_solid_angles(size).sum() * 6 == pytest.approx(4 * np.pi, rel=1e-12)
    directions = cube_directions(size)
    face, place = cube_places(directions.reshape(-1, 3), size)
    index = (face * size + np.rint(place[:, 1]).astype(int)) * size + np.rint(place[:, 0]).astype(int)
    np.testing.assert_array_equal(index, np.arange(6 * size * size))
    index, weight = cube_taps(directions.reshape(-1, 3), size)
    np.testing.assert_allclose((weight * (index == np.arange(6 * size * size)[:, None])).sum(axis=1), 1, atol=1e-9)


def test_faces_look_along_their_axes_and_run_as_in_opengl():
    """On +X, columns run toward -Z and rows toward -Y; on +Y and -Y, columns toward +X."""
    middle = cube_directions(1)[:, 0, 0]
    np.testing.assert_allclose(middle, [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    directions = cube_directions(4)
    assert (np.diff(directions[0, 0, :, 2]) < 0).all()
    assert (np.diff(directions[0, :, 0, 1]) < 0).all()
    assert (np.diff(directions[2:4, 0, :, 0]) > 0).all()


def test_a_linear_field_is_read_back_smoothly_across_edges():
    """Linear between texels: off by no more than the field bends within a texel, edges and corners included."""
    size, rng = 32, np.random.default_rng(3)
    radiance = 2.0 + cube_directions(size)
    found = Environment(radiance.astype(np.float32))
    directions = rng.normal(size=(4000, 3))
    directions[:6] = [[1, 1, 1], [-1, 1, 1], [1, 1, 0], [0, -1, 1], [1, -1, -1], [0, 0, -1]]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    assert np.abs(found.evaluate(7.0 * directions) - 2.0 - directions).max() < 0.7 * 2 / size


@settings(max_examples=15, deadline=None)
@given(st.integers(2, 24), st.integers(2, 9), st.integers(0, 2**32 - 1), st.floats(1e-6, 1e6))
def test_the_integral_is_kept_whatever_the_sizes(height, size, seed, scale):
    """To float32, also of single bright pixels, for panoramas finer and coarser than the cubemap, and back."""
    rng = np.random.default_rng(seed)
    picture = scale * rng.uniform(0, 1, (height, 2 * height, 3))
    picture[rng.integers(height), rng.integers(2 * height)] = 1e5 * scale
    panorama = Panorama(picture, azimuth_rad=rng.uniform(-4, 4))
    cubemap = cubemap_of(panorama, size)
    np.testing.assert_allclose(cubemap.integral, integral(panorama), rtol=1e-5)
    np.testing.assert_allclose(integral(panorama_of(cubemap, height)), cubemap.integral, rtol=1e-5)


@pytest.mark.parametrize(("height", "size"), [(64, 16), (30, 24), (16, 32)])
def test_a_uniform_sky_stays_uniform(height, size):
    """Weights of samples and cells agree to a percent at the worst corner."""
    found = cubemap_of(Panorama(np.full((height, 2 * height, 3), 3.0)), size).radiance
    np.testing.assert_allclose(found, 3.0, rtol=0.01)


def test_light_stays_where_it_came_from():
    """A bright spot's direction, weighted by its light, moves by no more than half a texel's diagonal."""
    height, size = 96, 16
    for row, column in [(40, 10), (3, 100), (0, 0), (95, 50), (70, 191)]:
        picture = np.zeros((height, 2 * height, 3))
        picture[row, column] = 1.0
        panorama, seen = Panorama(picture, 0.7), RenderEnvironment(np.ones((height, 2 * height, 3), np.float32), 0.7)
        found = cubemap_of(panorama, size)
        weights = (found.radiance[..., 0] * found.solid_angles)[..., None]
        mean = (weights * found.directions).sum(axis=(0, 1, 2)) / weights.sum()
        assert np.linalg.norm(mean / np.linalg.norm(mean) - seen.directions[row, column]) < 0.71 * 2 / size


def test_panoramas_turn_as_the_preview_reads_them():
    """A smooth environment's panorama holds what lies where the preview looks, to half a pixel."""
    directions = cube_directions(48)
    found = panorama_of(Environment((2.0 + directions).astype(np.float32)), 24).picture
    seen = RenderEnvironment(np.asarray(found, np.float32)).directions
    np.testing.assert_allclose(found, 2.0 + seen, atol=0.5 * np.pi / 24)


def test_irradiance_of_a_uniform_sky_is_pi():
    sky = Environment(np.ones((6, 32, 32, 3), np.float32))
    normals = np.array([[0, 0, 1], [1, 1, 1] / np.sqrt(3), [0, -1, 0]])
    np.testing.assert_allclose(sky.irradiance(normals), np.pi, rtol=2e-3)


@pytest.mark.parametrize("suffix", [".exr", ".hdr"])
def test_files_of_panoramas_come_back(tmp_path, suffix):
    rng = np.random.default_rng(1)
    smooth = Environment((2.0 + cube_directions(16) * rng.uniform(0, 1, 3)).astype(np.float32))
    path = tmp_path / f"light{suffix}"
    write_panorama(path, smooth, 64)
    found, repaired = read_environment(path, 16)
    assert repaired == 0
    np.testing.assert_allclose(found.radiance, smooth.radiance, rtol=0.03)
    np.testing.assert_allclose(found.integral, smooth.integral, rtol=1e-5 if suffix == ".exr" else 0.004)


def test_the_product_comes_back_whole(tmp_path):
    rng = np.random.default_rng(2)
    radiance = rng.exponential(size=(6, 5, 5, 3)).astype(np.float32)
    Environment(radiance).save(tmp_path)
    np.testing.assert_array_equal(Environment.load(tmp_path).radiance, radiance)
    (tmp_path / "environment.exr").write_bytes(b"no picture")
    with pytest.raises(ImageError, match="not a whole cubemap"):
        Environment.load(tmp_path)


@pytest.mark.parametrize(
    ("radiance", "reason"),
    [
        (np.zeros((5, 4, 4, 3), np.float32), "cubemap"),
        (np.zeros((6, 4, 3, 3), np.float32), "cubemap"),
        (np.zeros((6, 4, 4, 3)), "float32"),
        (np.full((6, 4, 4, 3), np.nan, np.float32), "no numbers"),
        (np.full((6, 4, 4, 3), np.inf, np.float32), "no numbers"),
        (np.full((6, 4, 4, 3), -1.0, np.float32), "negative"),
    ],
)
def test_what_is_no_light_is_refused(radiance, reason):
    with pytest.raises(ImageError, match=reason):
        Environment(radiance)


def test_few_bad_values_are_repaired_and_told_many_are_refused(tmp_path):
    """Infinity, as half floats have it for a sun, becomes the largest value; what is no number, its surroundings."""
    picture = np.full((16, 32, 3), 0.5, np.float32)
    picture[3, 4], picture[8, 9], picture[2, 2] = np.inf, np.nan, 7.0
    mended = repair(picture)
    assert mended.count == 6
    np.testing.assert_allclose(mended.picture[3, 4], 7.0)
    np.testing.assert_allclose(mended.picture[8, 9], 0.5, atol=1e-9)
    path = tmp_path / "bad.exr"
    write_exr(path, ExrImage(picture))
    found, repaired = read_environment(path, 8)
    assert repaired == 6
    assert found.provenance.parameters["repaired_values"] == 6
    picture[:4] = np.nan
    write_exr(path, ExrImage(picture))
    with pytest.raises(ImageError, match=r"bad\.exr: \d+ of \d+ values"):
        read_environment(path, 8)


def test_a_picture_of_another_shape_is_refused(tmp_path):
    write_exr(tmp_path / "square.exr", ExrImage(np.ones((8, 8, 3), np.float32)))
    with pytest.raises(ImageError, match="twice as wide"):
        read_environment(tmp_path / "square.exr", 8)
    with pytest.raises(ImageError, match=r"none\.hdr"):
        read_environment(tmp_path / "none.hdr", 8)
    (tmp_path / "text.hdr").write_text("no picture")
    with pytest.raises(ImageError, match="not a Radiance picture"):
        read_environment(tmp_path / "text.hdr", 8)


@pytest.mark.skipif(not (DATA / "environments").is_dir(), reason="public environments are not here")
def test_real_environments_keep_their_light():
    for path in sorted((DATA / "environments").glob("*.exr")):
        found, repaired = read_environment(path, 32)
        preview = RenderEnvironment(np.maximum(read_exr(path).image, 0))
        np.testing.assert_allclose(found.integral, preview.irradiance.sum(axis=(0, 1)), rtol=1e-5)
        assert repaired == 0
