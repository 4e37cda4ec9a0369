import numpy as np
import pytest

from simulators.layout import direction
from simulators.sphere_truth import camera_axes, reflectance_maps

SIZE = 17


def _turned(eye_m: np.ndarray, in_view: np.ndarray) -> np.ndarray:
    """Places given as right, up and toward the camera, in the rig's frame."""
    return in_view * [1, -1, -1] @ camera_axes(eye_m).T


def test_a_level_camera_sees_up_above_and_right_right():
    """From the front +y is right and +z up; from the zenith +y is right and -x up."""
    np.testing.assert_allclose(camera_axes(np.array([1.1, 0, 0])).T, [[0, 1, 0], [0, 0, -1], [-1, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(camera_axes(np.array([0, 0, 1.1])).T, [[0, 1, 0], [1, 0, 0], [0, 0, -1]], atol=1e-12)


@pytest.mark.parametrize("elevation_rad", [0.6, np.pi / 2])
def test_an_even_sphere_looks_the_same_from_everywhere(elevation_rad):
    """The glaze is the same all over: if lights turn with the eye, the maps stay."""
    lights = np.array([[0.3, 0.1, 0.5], [-0.4, 0.3, 0.2]])
    front, other = np.array([1.1, 0, 0]), 1.1 * direction(0.0 if elevation_rad > 1 else 2.0, elevation_rad)
    maps = [reflectance_maps("sphere-glaze", 1, _turned(eye, lights), eye, SIZE) for eye in (front, other)]
    np.testing.assert_allclose(maps[0], maps[1], rtol=1e-4, atol=1e-6)


def test_rows_run_down_and_columns_right():
    eye = np.array([1.1, 0, 0])
    above, right = reflectance_maps(
        "sphere-glaze", 1, _turned(eye, np.array([[0, 0.5, 0.3], [0.5, 0, 0.3]])), eye, SIZE
    )
    assert above[:8].mean() > 2 * above[9:].mean()
    assert right[:, 9:].mean() > 2 * right[:, :8].mean()


def test_the_highlight_lies_where_the_normal_halves_light_and_view():
    eye, size = np.array([1.1, 0, 0]), 64
    light = 0.6 * direction(np.radians(40), np.radians(20))
    (seen,) = reflectance_maps("sphere-glaze", 1, light[None], eye, size)
    row, column = np.unravel_index(np.argmax(seen[..., 1]), (size, size))
    half = light / 0.6 + eye / 1.1
    x, y, z = half @ camera_axes(eye)
    expected = (np.array([x, y]) / -z + 1) * size / 2 - 0.5
    np.testing.assert_allclose([column, row], expected, atol=2)  # light and eye are near: half a degree, one cell


def test_values_do_not_depend_on_the_lamps_distance_where_it_shines():
    """They are over what each point receives; the direction alone changes a little."""
    eye, toward = np.array([1.1, 0, 0]), direction(0.3, 0.2)
    near, far = reflectance_maps("sphere-wax", 2, np.array([5 * toward, 50 * toward]), eye, SIZE)
    np.testing.assert_allclose(near, far, atol=0.01)


def test_a_cell_is_the_mean_over_finer_cells():
    """Of wax, which is smooth: each of the nine points of a cell stands for a cell of the finer map."""
    eye, light = np.array([1.1, 0, 0]), np.array([[0.5, 0.2, 0.1]])
    coarse = reflectance_maps("sphere-wax", 1, light, eye, 16)
    fine = reflectance_maps("sphere-wax", 1, light, eye, 48).reshape(1, 16, 3, 16, 3, 3).mean(axis=(2, 4))
    assert np.sqrt(np.mean((coarse - fine) ** 2)) < 0.02 * fine.std()


def test_what_a_near_eye_cannot_see_is_missing():
    maps = reflectance_maps("sphere", 1, np.array([[0.5, 0, 0]]), np.array([0.06, 0, 0]), SIZE)
    assert np.isnan(maps[0, 0, 0]).all()
    assert np.isfinite(maps[0, SIZE // 2, SIZE // 2]).all()


def test_another_sample_is_no_sphere():
    with pytest.raises(ValueError, match="'brick' is no sphere: one of sphere, sphere-glaze"):
        reflectance_maps("brick", 1, np.array([[0.5, 0, 0]]), np.array([1.1, 0, 0]), SIZE)
