"""Pictures of a calibrated rig are drawn, with an axis and without."""

import numpy as np
import pytest
from PIL import Image

from processing.cameras.calibration import survey
from service.survey_pictures import draw_network, draw_residuals
from tests.reference.camera_rig import BOARD, camera_rig


@pytest.mark.parametrize("turns_deg", [(), (-120, 120)])
def test_pictures_of_a_survey(tmp_path, turns_deg):
    rng = np.random.default_rng(0)
    rig = camera_rig(rng, elevations_deg=(30, 45, 60, 75, 88), turns_deg=turns_deg, poses=4)
    found = survey(rig.views(0.1, rng), rig.sizes)
    draw_residuals(found, tmp_path / "residuals.png")
    draw_network(found, BOARD, tmp_path / "network.png")
    for name in ("residuals.png", "network.png"):
        picture = np.asarray(Image.open(tmp_path / name).convert("L"))
        assert min(picture.shape) > 300
        assert 0.002 < np.mean(picture < 200) < 0.5  # something is drawn, on white
