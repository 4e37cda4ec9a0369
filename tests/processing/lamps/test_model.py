"""Lamp models as files and as numbers."""

import json

import numpy as np
import pytest

from processing.errors import CalibrationError
from processing.lamps.model import LampModel, LampStatus, nominal_position, read_lamps, write_lamps

LAMP = LampModel(
    "lamp3", "light_arc", nominal_position(0.7, 0.9), np.diag([1e-6, 4e-6, 9e-6]), LampStatus.DISTANCE_ASSUMED,
    np.array([1.0, 2.0, np.nan]), np.array([0.1, 0.2, np.nan]), 2.0, 0.03,
)  # fmt: skip


def test_written_lamps_are_read_back(tmp_path):
    write_lamps({"lamp3": LAMP}, tmp_path / "lamps.json")
    again = read_lamps(tmp_path / "lamps.json")["lamp3"]
    assert (again.name, again.mount, again.status, again.falloff) == ("lamp3", "light_arc", LAMP.status, 2.0)
    for name in ("position_m", "covariance_m2", "intensity_e_s", "intensity_deviation"):
        np.testing.assert_array_equal(getattr(again, name), getattr(LAMP, name))
    json.loads((tmp_path / "lamps.json").read_text(), parse_constant=pytest.fail)  # no NaN in it


NO_FIELDS = '{"schema": "lamp-models/1", "lamps": {"a": {}}}'


@pytest.mark.parametrize("text", ["", "[]", '{"schema": "lamp-models/9"}', NO_FIELDS])
def test_what_is_no_such_file_is_named(tmp_path, text):
    path = tmp_path / "lamps.json"
    path.write_text(text)
    with pytest.raises(CalibrationError, match=r"lamps\.json"):
        read_lamps(path)


def test_deviations_along_and_across():
    lamp = LampModel("a", "arm", np.array([0.0, 0.0, 2.0]), np.diag([1e-4, 1e-4, 9e-4]))
    assert lamp.distance_deviation_m == pytest.approx(0.03)
    assert lamp.direction_deviation_rad == pytest.approx(np.sqrt(2) * 0.01 / 2)
