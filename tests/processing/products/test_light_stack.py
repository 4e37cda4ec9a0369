"""Stacks of one picture per light: frame, near lights, files, refusals."""

import numpy as np
import pytest

from processing.errors import ImageError
from processing.products import LightStack, Provenance, plane_points

ROWS, COLUMNS, PIXEL_M = 4, 6, 0.002


def stack(distances_m=(np.inf, 0.5), **changes) -> LightStack:
    rng = np.random.default_rng(5)
    shape = (2, ROWS, COLUMNS, 3)
    given = {
        "reflectance_cos": rng.uniform(0, 0.3, shape).astype(np.float32),
        "variance": rng.uniform(1e-6, 1e-5, shape).astype(np.float32),
        "light_directions": np.array([[0.0, 0.6, 0.8], [0.6, 0.0, 0.8]]),
        "light_distances_m": np.array(distances_m),
        "pixel_m": PIXEL_M,
    }
    return LightStack(**(given | changes), provenance=Provenance(("frames",)))


def test_y_runs_up_the_picture_and_the_origin_is_its_middle():
    points = plane_points((ROWS, COLUMNS), PIXEL_M)
    np.testing.assert_allclose(points.mean(axis=(0, 1)), 0, atol=1e-18)
    np.testing.assert_allclose(points[0, 0], [-2.5 * PIXEL_M, 1.5 * PIXEL_M, 0])
    np.testing.assert_allclose(points[-1, -1], -points[0, 0])


def test_a_near_light_is_seen_from_each_point():
    toward = stack().lights()
    assert toward.shape == (2, ROWS, COLUMNS, 3)
    np.testing.assert_array_equal(toward[0], np.broadcast_to([0.0, 0.6, 0.8], (ROWS, COLUMNS, 3)))
    lamp = np.array([0.3, 0.0, 0.4])
    away = lamp - plane_points((ROWS, COLUMNS), PIXEL_M)[0, 5]
    np.testing.assert_allclose(toward[1, 0, 5], away / np.linalg.norm(away), atol=1e-15)


def test_a_saved_stack_is_the_same_stack(tmp_path):
    before = stack()
    before.save(tmp_path)
    after = LightStack.load(tmp_path)
    for name in ("reflectance_cos", "variance", "light_directions", "light_distances_m"):
        np.testing.assert_array_equal(getattr(before, name), getattr(after, name))
    assert (after.pixel_m, after.provenance) == (before.pixel_m, before.provenance)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"variance": np.zeros((2, ROWS, COLUMNS), np.float32)}, "variances"),
        ({"light_directions": np.array([[0.0, 0, 1]])}, "1 lights"),
        ({"light_directions": np.array([[0.0, 0, 1], [0, 0, 2]])}, "unit vector"),
        ({"light_distances_m": np.array([np.inf])}, "distances"),
        ({"light_distances_m": np.array([0.5, -0.1])}, "positive"),
        ({"pixel_m": 0.0}, "positive"),
    ],
)
def test_what_does_not_belong_together_is_refused(changes, told):
    with pytest.raises(ImageError, match=told):
        stack(**changes)
