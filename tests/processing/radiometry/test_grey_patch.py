"""White balance from a grey patch."""

import numpy as np
import pytest

from processing.errors import ImageError
from processing.radiometry.grey_patch import measure_grey_patch
from processing.radiometry.hdr import PixelStatus, Radiance

BOX = (10, 5, 12, 8)


def picture(rng, level=(2.0, 1.0, 0.5), noise=0.02):
    level = np.asarray(level)
    value = (level + noise * level * rng.normal(size=(30, 40, 3))).astype(np.float32)
    variance = np.broadcast_to((noise * level) ** 2, value.shape).astype(np.float32)
    return Radiance(value, variance, np.zeros(value.shape, np.uint8))


def test_multipliers_make_the_patch_grey_and_know_their_error():
    """200 pictures: the mean is right, and so is the deviation; a few dead leaves on the card change little."""
    rng = np.random.default_rng(0)
    found = []
    for _ in range(200):
        radiance = picture(rng)
        radiance.value[6, 11:13] *= 3
        found.append(measure_grey_patch(radiance, BOX))
    multipliers = np.array([one.multipliers for one in found])
    np.testing.assert_allclose(multipliers.mean(axis=0), [0.5, 1, 2], rtol=1e-3)
    np.testing.assert_allclose(found[0].sigma[[0, 2]], multipliers.std(axis=0)[[0, 2]], rtol=0.25)
    assert found[0].multipliers[1] == 1


def shaded(radiance):
    radiance.value[:, :, :] *= np.linspace(0.3, 3, 40)[:, None]


def marked(status, share):
    def change(radiance):
        radiance.status[: 5 + int(8 * share)] = status

    return change


@pytest.mark.parametrize(
    ("change", "box", "reason"),
    [
        (shaded, BOX, "uneven"),
        (marked(PixelStatus.SATURATED, 0.5), BOX, "saturated in every exposure"),
        (marked(PixelStatus.DARK, 0.5), BOX, "dark"),
        (marked(PixelStatus.MISSING, 0.5), BOX, "no value"),
        (None, (30, 5, 12, 8), "leaves the picture"),
        (None, (-1, 5, 12, 8), "leaves the picture"),
        (None, (3, 5, 2, 2), "at least"),
    ],
)
def test_a_patch_that_tells_nothing_is_refused_with_the_reason(change, box, reason):
    radiance = picture(np.random.default_rng(1))
    if change is not None:
        change(radiance)
    with pytest.raises(ImageError, match=reason):
        measure_grey_patch(radiance, box)
