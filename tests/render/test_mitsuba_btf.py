"""The rival that frames are timed beside looks up what it should."""

import numpy as np
import pytest

from processing.products import Btf
from tests.benchmarks.yardsticks.mitsuba_btf import NearestPairs, rendered
from tests.render import synthetic


@pytest.fixture(scope="module")
def measured() -> Btf:
    directions = synthetic.hemisphere()
    values = np.random.default_rng(2).uniform(0.1, 0.3, (len(directions), len(directions), 3, 2, 3))
    return Btf(values.astype(np.float32), directions, directions)


def test_measured_pairs_answer_for_themselves(measured):
    """Others have next to no weight: their distance is some 1e5 times as large."""
    light, view = measured.light_directions[3:7], measured.view_directions[5:9]
    uv = np.array([[0.25, 0.1], [0.75, 0.4], [0.25, 0.9], [1.75, -0.1]])
    found = NearestPairs(measured)(uv, light, view)
    rows, columns = [0, 1, 2, 2], [0, 1, 0, 1]
    expected = measured.reflectance[range(3, 7), range(5, 9), rows, columns] * light[:, 2:]
    np.testing.assert_allclose(found, expected, rtol=1e-4)


def test_mitsuba_draws_the_measured_plane():
    """All values alike: radiance is reflectance times cosine times irradiance."""
    pytest.importorskip("mitsuba", reason="Mitsuba is not installed")
    directions = synthetic.hemisphere()
    alike = Btf(np.full((25, 25, 2, 2, 3), 0.2, np.float32), directions, directions)
    seconds, picture = rendered(alike, 6)
    assert seconds > 0.0
    np.testing.assert_allclose(picture, 0.2 * 0.8 / np.sqrt(0.98), rtol=1e-5)
