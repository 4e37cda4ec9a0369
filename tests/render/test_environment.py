"""Light from all around: where its pixels are, how few lights stand for them, what its files say."""

import cv2
import numpy as np
import OpenEXR
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.products import FactoredBtf
from render.environment import Environment, median_cut
from render.environment_file import load_environment
from render.errors import SceneError
from render.reference import ReferenceRenderer
from render.scene import Scene, framed
from render.shapes import sphere
from tests.render import synthetic

WHITE = np.ones((8, 16, 3), np.float32)


def test_directions_of_a_panorama():
    """Top row up, middle column at the azimuth, the left quarter a quarter turn counterclockwise from above."""
    environment = Environment(np.ones((64, 128, 3), np.float32), np.radians(30.0))
    directions = environment.directions
    np.testing.assert_allclose(np.linalg.norm(directions, axis=2), 1.0)
    assert directions[0, 0, 2] > 0.999
    middle = directions[31:33, 63:65].mean(axis=(0, 1))
    np.testing.assert_allclose(middle, synthetic.direction_rad(np.radians(30.0), 0.0), atol=1e-3)
    left = directions[31:33, 31:33].mean(axis=(0, 1))
    np.testing.assert_allclose(left, synthetic.direction_rad(np.radians(120.0), 0.0), atol=1e-3)


def test_pixels_fill_the_sphere():
    np.testing.assert_allclose(Environment(WHITE).irradiance.sum(axis=(0, 1)), 4.0 * np.pi)


def test_white_all_around_lights_a_matt_sphere_alike():
    """Radiance 1 everywhere: each point of a matt surface receives pi and returns its albedo, to what 128 lights do."""
    lights = median_cut(Environment(np.ones((64, 128, 3), np.float32)), 128)
    mesh = sphere(shape=(32, 64))
    camera = framed(mesh, (40, 40), azimuth_rad=0.3, elevation_rad=0.2)
    picture = ReferenceRenderer().draw(Scene.of(mesh, synthetic.lambertian((0.5, 0.4, 0.3)), camera, lights))
    shown = picture.radiance[picture.mask]
    np.testing.assert_allclose(shown / [0.5, 0.4, 0.3], 1.0, atol=0.06)
    np.testing.assert_allclose(shown.mean(axis=0) / [0.5, 0.4, 0.3], 1.0, atol=0.01)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), count=st.integers(1, 200), scale=st.sampled_from([1e-6, 1.0, 1e6]))
def test_no_light_is_lost_and_none_counted_twice(seed, count, scale):
    """Of any picture, with black pixels and some a thousand times brighter; directions do not depend on the scale."""
    rng = np.random.default_rng(seed)
    radiance = np.exp(rng.normal(scale=2.0, size=(6, 12, 3))) * (rng.random((6, 12, 1)) > 0.3)
    environment = Environment((scale * radiance).astype(np.float32), 0.7)
    lights = median_cut(environment, count)
    assert len(lights) <= count
    total = np.sum([each.irradiance for each in lights], axis=0)
    np.testing.assert_allclose(total, environment.irradiance.sum(axis=(0, 1)), rtol=1e-9)
    np.testing.assert_allclose([np.linalg.norm(each.direction) for each in lights], 1.0, rtol=1e-12)
    if scale == 1.0 and count <= 40:
        # Halves may tie where rounding decides; powers of two change no digit.
        again = median_cut(Environment((1024.0 * radiance).astype(np.float32), 0.7), count)
        np.testing.assert_allclose([a.direction for a in again], [b.direction for b in lights], atol=1e-12)


def test_as_many_lights_as_pixels_are_the_pixels():
    environment = synthetic.daylight(8)
    lights = median_cut(environment, 128)
    assert len(lights) == 128
    found = {tuple(each.direction.round(9)): each.irradiance for each in lights}
    for direction, irradiance in zip(
        environment.directions.reshape(-1, 3), environment.irradiance.reshape(-1, 3), strict=True
    ):
        np.testing.assert_allclose(found[tuple(direction.round(9))], irradiance, rtol=1e-12)


def test_a_single_bright_pixel_is_one_light_of_all():
    radiance = np.zeros((16, 32, 3), np.float32)
    radiance[5, 7] = 3.0
    (only,) = median_cut(Environment(radiance), 64)
    np.testing.assert_allclose(only.direction, Environment(radiance).directions[5, 7], atol=1e-12)


def test_regions_that_shine_alike_from_opposite_sides_still_have_a_direction():
    (only,) = median_cut(Environment(WHITE), 1)
    assert np.linalg.norm(only.direction) == pytest.approx(1.0)


def test_more_lights_come_closer_to_all_pixels(gl):
    """On a shiny stone: the root mean square error falls with the number, and is small at the 64 of the preview."""
    environment, mesh = synthetic.daylight(24), sphere(shape=(32, 64))
    camera = framed(mesh, (48, 48), azimuth_rad=0.8, elevation_rad=0.3)

    def drawn(count: int) -> np.ndarray:
        picture = gl.draw(Scene.of(mesh, synthetic.stone(), camera, median_cut(environment, count)))
        return picture.radiance[picture.mask]

    full = drawn(24 * 48)
    error = [np.sqrt(np.mean((drawn(count) - full) ** 2)) / full.mean() for count in (4, 16, 64)]
    assert error[0] > error[1] > error[2]
    assert error[2] < 0.05


def test_reference_and_shader_draw_the_same_under_an_environment(gl, btf: FactoredBtf):
    mesh = sphere(shape=(24, 48))
    camera = framed(mesh, (40, 40), azimuth_rad=0.3, elevation_rad=0.2)
    lights = median_cut(synthetic.daylight(16), 64)
    for material in (synthetic.stone(), btf):
        scene = Scene.of(mesh, material, camera, lights)
        one, other = gl.draw(scene), ReferenceRenderer().draw(scene)
        both = one.mask & other.mask
        error = np.abs(one.radiance - other.radiance)[both]
        assert np.percentile(error, 99) <= 1e-3 * other.radiance.max()


@pytest.mark.parametrize("channels", ["RGB", "RGBA", "separate"])
def test_exr_is_read_as_it_was_written(tmp_path, channels):
    radiance = synthetic.daylight(8).radiance
    alpha = np.ones((8, 16, 1), np.float32)
    written = {
        "RGB": {"RGB": radiance},
        "RGBA": {"RGBA": np.concatenate([radiance, alpha], axis=2)},
        "separate": {name: np.ascontiguousarray(radiance[..., k]) for k, name in enumerate("RGB")},
    }[channels]
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, written) as image:
        image.write(str(tmp_path / "sky.exr"))
    read = load_environment(tmp_path / "sky.exr", azimuth_rad=0.5)
    np.testing.assert_array_equal(read.radiance, radiance)
    assert read.azimuth_rad == 0.5


def test_radiance_file_is_read_to_its_eight_bits(tmp_path):
    radiance = synthetic.daylight(8).radiance
    cv2.imwrite(str(tmp_path / "sky.hdr"), radiance[:, :, ::-1])
    read = load_environment(tmp_path / "sky.hdr").radiance
    np.testing.assert_array_less(np.abs(read - radiance).max(axis=2), radiance.max(axis=2) / 120)


def test_what_is_no_environment_is_said(tmp_path):
    (tmp_path / "text.exr").write_text("no picture")
    (tmp_path / "text.hdr").write_text("no picture")
    cv2.imwrite(str(tmp_path / "photo.png"), np.zeros((8, 16, 3), np.uint8))
    cv2.imwrite(str(tmp_path / "square.hdr"), np.ones((8, 8, 3), np.float32))
    cv2.imwrite(str(tmp_path / "black.hdr"), np.zeros((8, 16, 3), np.float32))
    for name, what in (
        ("absent.hdr", "no such file"),
        ("text.exr", "not an OpenEXR picture"),
        ("text.hdr", "not a picture of linear light"),
        ("photo.png", "not a picture of linear light"),
        ("square.hdr", r"square\.hdr: an environment is \(h, 2 h, 3\)"),
    ):
        with pytest.raises(SceneError, match=what):
            load_environment(tmp_path / name)
    with pytest.raises(SceneError, match="black all around"):
        median_cut(load_environment(tmp_path / "black.hdr"), 8)
    with pytest.raises(SceneError, match="negative or no numbers"):
        Environment(np.full((4, 8, 3), np.nan, np.float32))
