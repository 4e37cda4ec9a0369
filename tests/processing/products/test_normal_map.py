"""Normal maps: files and refusals."""

import numpy as np
import pytest

from processing.errors import ImageError
from processing.products import LightStack, NormalMap, NormalStatus


def normal_map(**changes) -> NormalMap:
    rng = np.random.default_rng(6)
    normals = rng.normal(size=(3, 4, 3)).astype(np.float32)
    given = {
        "normals": normals / np.linalg.norm(normals, axis=-1, keepdims=True),
        "albedo": rng.uniform(0, 1, (3, 4, 3)).astype(np.float32),
        "variance": rng.uniform(0, 1e-4, (3, 4)).astype(np.float32),
        "status": (np.arange(12).reshape(3, 4) % 2).astype(np.uint8),
        "pixel_m": 1e-4,
        "depth_m": rng.normal(size=(3, 4)).astype(np.float32),
    }
    return NormalMap(**(given | changes))


def test_a_saved_map_is_the_same_map(tmp_path):
    before = normal_map()
    before.save(tmp_path)
    after = NormalMap.load(tmp_path)
    for name in ("normals", "albedo", "variance", "status", "depth_m"):
        np.testing.assert_array_equal(getattr(before, name), getattr(after, name))
    assert after.pixel_m == before.pixel_m
    np.testing.assert_array_equal(after.measured, before.status == NormalStatus.MEASURED)


def test_another_product_is_refused(tmp_path):
    normal_map().save(tmp_path)
    with pytest.raises(ImageError, match="expected a light_stack"):
        LightStack.load(tmp_path)


@pytest.mark.parametrize("name", ["normals", "albedo", "variance", "depth_m"])
def test_shapes_that_do_not_belong_together_are_refused(name):
    with pytest.raises(ImageError, match="not"):
        normal_map(**{name: np.zeros((3, 5, 3), np.float32)})
