import numpy as np
import pytest

ARM_DEG = [-60, -50, -40, -30, -20, -10, 10, 20, 30, 40, 50, 60]


@pytest.fixture
def rng():
    return np.random.default_rng(20040101)


@pytest.fixture
def arm_directions():
    """The twelve lights of the LED arm, in the camera frame."""
    azimuth = np.radians(ARM_DEG)
    return np.stack([np.sin(azimuth), np.zeros(12), -np.cos(azimuth)], axis=1)


@pytest.fixture
def hemisphere(rng):
    """Forty directions spread over the upper hemisphere, by Fibonacci's spiral."""
    z = 1 - (np.arange(40) + 0.5) / 40 * 0.9
    azimuth = np.arange(40) * np.pi * (3 - np.sqrt(5))
    return np.stack([np.sqrt(1 - z * z) * np.cos(azimuth), np.sqrt(1 - z * z) * np.sin(azimuth), z], axis=1)
