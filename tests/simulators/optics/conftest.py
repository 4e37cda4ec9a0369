"""One small simulated rig for all tests of its optics."""

from collections.abc import Callable
from dataclasses import replace
from math import radians
from typing import Any

import pytest

from simulators.optics import Optics
from simulators.pose import Pose
from simulators.studio import Studio

DARK = Pose("white", 0, 0.0, radians(90.0), 0.0, (), radians(50.0), False, None)


@pytest.fixture(scope="session")
def optics(tmp_path_factory: pytest.TempPathFactory) -> Optics:
    return Optics(1, "small", tmp_path_factory.mktemp("truth"))


@pytest.fixture(scope="session")
def studio() -> Studio:
    return Studio(1, "small")


@pytest.fixture(scope="session")
def pose() -> Callable[..., Pose]:
    """A pose that differs from a dark one (white sample, arc at 90 deg) in what is named."""

    def make(**changes: Any) -> Pose:
        return replace(DARK, **changes)

    return make
