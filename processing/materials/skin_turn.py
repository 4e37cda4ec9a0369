"""Coefficients of a residual basis in a frame that is turned about the normal."""

import numpy as np

from processing.products.arrays import Float64
from processing.products.residual_basis import ResidualBasis

_ANGLES = 5  # the harmonics 0, 1 and 2 of the azimuth have five parts
STEPS = 1024  # a table of so many angles is off by 0.003 rad at most


def turning_table(basis: ResidualBasis) -> Float64:
    """Matrices (STEPS, k, k) that take coefficients in a frame turned by 2 pi step / STEPS from t to b to the frame.

    Exact for every basis whose functions reach the second harmonic of the azimuth, and turn into each other: the
    matrices are solved for at five angles and continued by their Fourier series.
    """
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(2, 200, 3))
    directions[..., 2] = np.abs(directions[..., 2])
    light, view = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    solve = np.linalg.pinv(basis.evaluate(light, view))
    turned = [_turned(-angle, light, view) for angle in _angles(_ANGLES)]
    matrices = np.stack([solve @ basis.evaluate(*each) for each in turned])
    series = np.linalg.solve(_harmonics(_angles(_ANGLES)), matrices.reshape(_ANGLES, -1))
    return (_harmonics(_angles(STEPS)) @ series).reshape(STEPS, basis.size, basis.size)


def _angles(count: int) -> Float64:
    return 2.0 * np.pi * np.arange(count) / count


def _harmonics(angles_rad: Float64) -> Float64:
    once, twice = np.exp(1j * angles_rad), np.exp(2j * angles_rad)
    return np.stack([np.ones(len(once)), once.real, once.imag, twice.real, twice.imag], axis=1)


def _turned(angle_rad: float, *directions: Float64) -> list[Float64]:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return [each @ turn for each in directions]
