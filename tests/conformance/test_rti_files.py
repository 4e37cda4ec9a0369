"""Files for relighting viewers, read by a reader that shares no code with the writer, pixel by pixel."""

import numpy as np
import pytest

from processing.formats.ptm import write_ptm
from processing.formats.relight import write_relight
from processing.formats.rti import write_rti
from processing.materials.ptm import as_lrgb, fit_ptm
from processing.products import ResidualBasis
from tests.conformance.rti_reader import ptm_pixel, rti_pixel, web_pixel
from tests.reference.ptm import board, dome

LIGHTS = dome(32)
PICTURES = board(LIGHTS, (17, 25), seed=5)
PTM = fit_ptm(PICTURES, LIGHTS).image
HSH = fit_ptm(PICTURES, LIGHTS, ResidualBasis.HEMISPHERICAL).image
TRIED = [(0, 0), (24, 0), (0, 16), (24, 16), (7, 3), (13, 11)]


def rms_codes(read, path, image):
    """Of the reader against the image that was written, over some pixels and lights."""
    errors = [
        np.array(read(path, x, y, light)) - 255 * image.evaluate(light)[y, x] for x, y in TRIED for light in LIGHTS[::3]
    ]
    return np.sqrt(np.mean(np.square(errors)))


@pytest.mark.parametrize("image", [PTM, as_lrgb(PTM)], ids=["rgb", "lrgb"])
def test_ptm_is_read_by_others(tmp_path, image):
    write_ptm(tmp_path / "a.ptm", image)
    assert rms_codes(ptm_pixel, tmp_path / "a.ptm", image) < 1.5


def test_rti_is_read_by_others(tmp_path):
    write_rti(tmp_path / "a.rti", HSH)
    assert rms_codes(rti_pixel, tmp_path / "a.rti", HSH) < 1.5


@pytest.mark.parametrize("image", [PTM, HSH], ids=["ptm", "hsh"])
def test_web_folder_is_read_by_others(tmp_path, image):
    """JPEG costs more than the bytes: single pixels are noise to it."""
    write_relight(tmp_path / "web", image)
    assert rms_codes(web_pixel, tmp_path / "web", image) < 6


def test_light_from_the_left_brightens_what_faces_left(tmp_path):
    """A frame that is turned or mirrored would pass between two readers of ours; not here."""
    slope = np.broadcast_to(LIGHTS[:, None, None, None] @ [-0.6, 0.0, 0.8], (32, 3, 4, 1)).reshape(32, 3, 4, 1)
    up = np.where(np.arange(3)[:, None, None] == 0, (LIGHTS @ [0.0, 0.6, 0.8])[:, None, None, None], slope)
    values = np.repeat(np.clip(up, 0, 1), 3, axis=-1).astype(np.float32)
    write_ptm(tmp_path / "a.ptm", fit_ptm(values, LIGHTS).image)
    left, right, above, below = (-0.7, 0, 0.714), (0.7, 0, 0.714), (0, 0.7, 0.714), (0, -0.7, 0.714)
    assert ptm_pixel(tmp_path / "a.ptm", 0, 2, left)[0] > ptm_pixel(tmp_path / "a.ptm", 0, 2, right)[0] + 50
    assert ptm_pixel(tmp_path / "a.ptm", 0, 0, above)[0] > ptm_pixel(tmp_path / "a.ptm", 0, 0, below)[0] + 50
