"""Measured BRDFs as text: directions, bands, and files that are broken."""

import numpy as np
import pytest

from processing.errors import ImageError
from processing.formats.measured_brdf import read_measured_brdf
from tests.public_data import DATA

TEXT = """# a comment
# num wls
3
450 550   # two of
650
0.5 0.0 0.25 3.0 0.1 0.2 0.3
1.0 0.5 0.5
-1.0 1 2 3
"""


def test_a_file_is_read_over_comments_and_line_ends(tmp_path):
    path = tmp_path / "one.brdf"
    path.write_text(TEXT)
    brdf = read_measured_brdf(path)
    assert brdf.wavelength_nm.tolist() == [450, 550, 650]
    assert brdf.value.tolist() == [[0.1, 0.2, 0.3], [1, 2, 3]]
    assert np.allclose(brdf.rgb(), [[0.3, 0.2, 0.1], [3, 2, 1]])
    assert np.allclose(brdf.light[0], [np.sin(0.5), 0, np.cos(0.5)])
    assert np.allclose(brdf.view[1, 1], np.sin(0.5) * np.sin(-1))


@pytest.mark.parametrize("text", ["", "# nothing", "3 450 550", TEXT + "0.5", "1 450 0 0 0 0 two", "0 1 2 3"])
def test_a_broken_file_is_named(tmp_path, text):
    path = tmp_path / "broken.brdf"
    path.write_text(text)
    with pytest.raises(ImageError, match=r"broken\.brdf"):
        read_measured_brdf(path)


@pytest.mark.skipif(not (DATA / "brdf").exists(), reason="public data is not here")
def test_measured_paints_are_read():
    brdf = read_measured_brdf(DATA / "brdf" / "cayman.brdf")
    assert brdf.value.shape == (1439, 31)
    assert brdf.light[:, 2].min() > 0
    assert brdf.view[:, 2].min() > 0
    assert brdf.value.max() > 600  # at grazing, a million times the median
