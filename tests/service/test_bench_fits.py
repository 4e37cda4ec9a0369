"""The benchmark of SRF fits on few draws: its bounds hold, and its peer solves the same problem."""

import numpy as np
import pytest

from processing.materials.phong import fit_blinn_phong
from tests.benchmarks.srfs import fits


def test_errors_lie_at_their_bounds():
    """20 fits of seven parameters are good to 6 %, 15 parameters of each kind to a fifth."""
    function, _ = fits.function_error(20)
    assert function["phong_error_over_bound"] == pytest.approx(1.0, abs=0.25)
    parameters, rows = fits.parameter_error(5)
    assert parameters["parameter_error_over_bound"] < 2.2
    residual = next(row for row in rows if str(row["distribution"]).endswith(" s"))
    assert residual["rms"] == pytest.approx(1.0, abs=0.05)


def test_scipy_finds_the_same_lobe():
    samples = fits.lobe_samples(np.random.default_rng(35), 3000)
    lobe = fit_blinn_phong(samples).phong
    np.testing.assert_allclose(fits.by_scipy(samples), [*lobe.diffuse, *lobe.specular, lobe.exponent], rtol=1e-4)
