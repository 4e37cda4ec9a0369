import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.materials.measurements import Measurements
from processing.materials.residual import ALIKE, ResidualEquations, Weighting
from processing.materials.sample_geometry import SampleGeometry
from processing.products import AnisotropicPhong, BlinnPhong, ResidualBasis
from tests.reference import residual as reference

LOBE = BlinnPhong(np.array([0.3, 0.2, 0.1]), np.array([0.2, 0.2, 0.3]), 20.0)
TEXELS = 5
TIGHT = 1e-3  # normal equations square it: rounding then stays under 1e-9


def directions(rng, *shape):
    """Unit vectors over the upper hemisphere and a little below it."""
    vectors = rng.normal(size=(*shape, 3))
    vectors[..., 2] = np.abs(vectors[..., 2]) - 0.1
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def samples(rng, count, shared=False):
    """Random samples, a third of them missing in some way."""
    value = rng.normal(size=(count, TEXELS, 3)).astype(np.float32)
    variance = rng.uniform(0.5, 2, value.shape).astype(np.float32)
    hole = rng.integers(0, 9, value.shape)
    value[hole == 0] = np.nan
    variance[hole == 1] = np.nan
    variance[hole == 2] = 0
    texels = 1 if shared else TEXELS
    return Measurements(value, variance, directions(rng, count, texels), directions(rng, 1, texels))


def table(measurements, basis):
    """The basis functions (direction, texel, k) by the products' own formula."""
    light, view = np.broadcast_arrays(measurements.light, measurements.view)
    values = basis.evaluate(light.reshape(-1, 3), view.reshape(-1, 3)).reshape(*light.shape[:2], basis.size)
    return np.broadcast_to(values, (*measurements.value.shape[:2], basis.size))


@pytest.mark.parametrize("basis", list(ResidualBasis))
def test_geometry_is_that_of_the_products_own_formulas(rng, basis):
    measured = samples(rng, 40)
    geometry = SampleGeometry.of(measured, basis)
    lit = (measured.cos_light > 0).T
    np.testing.assert_allclose(np.moveaxis(geometry.basis, 1, 2)[lit], table(measured, basis).transpose(1, 0, 2)[lit],
                               atol=1e-14)  # fmt: skip
    bare = AnisotropicPhong(np.zeros(3), np.ones(3), np.array([60.0, 4.0]), 0.3)
    light, view = np.broadcast_arrays(measured.light, measured.view)
    for lobe in (BlinnPhong(np.zeros(3), np.ones(3), 30.0), bare):
        truth = lobe.evaluate(light.reshape(-1, 3), view.reshape(-1, 3))[:, 0].reshape(light.shape[:2]).T
        np.testing.assert_allclose(geometry.power(lobe)[lit], truth[lit], atol=1e-12)


@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 2**32 - 1), st.integers(1, 12), st.sampled_from([TIGHT, 0.03, 0.3]),
    st.sampled_from(list(ResidualBasis)), st.booleans(),
)  # fmt: skip
def test_solution_is_the_pseudo_inverses(seed, count, tolerance, basis, shared):
    """Shortest coefficients, rank and condition; singular values near the tolerance may fall on either side."""
    rng = np.random.default_rng(seed)
    measured = samples(rng, count, shared)
    weights = np.where(measured.valid, 1 / (measured.variance.astype(float) + 0.5), 0.0)
    geometry = SampleGeometry.of(measured, basis)
    equations = ResidualEquations.of(measured, geometry, Weighting(True, np.full(3, 0.5)), tolerance)
    fit = equations.fit(geometry.power(LOBE), np.stack([LOBE.diffuse, LOBE.specular]))
    found, rank, condition = reference.fit(measured.delta(LOBE), table(measured, basis), weights, tolerance)
    clear = rank == fit.rank
    assert clear.mean() > 0.8
    np.testing.assert_array_equal(np.isnan(fit.coefficients).any(axis=-1), ~measured.valid.any(axis=0))
    np.testing.assert_allclose(fit.condition[clear], condition[clear], rtol=1e-3)
    scale = np.nanmax(np.abs(found), initial=1.0)
    np.testing.assert_allclose(fit.coefficients[clear], found[clear], atol=1e-5 * scale)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from(list(ResidualBasis)))
def test_products_are_those_of_the_columns_less_their_residuals(seed, basis):
    rng = np.random.default_rng(seed)
    measured = samples(rng, 14)
    equations = ResidualEquations.of(measured, SampleGeometry.of(measured, basis), ALIKE, TIGHT)
    columns = rng.normal(size=(TEXELS, 3, 14))
    raw, projected = equations.products(columns)
    functions = table(measured, basis)
    for channel in range(3):
        each = [
            reference.products(
                columns[t], functions[:, t], np.nan_to_num(measured.value[:, t, channel]),
                measured.valid[:, t, channel].astype(float), TIGHT,
            )
            for t in range(TEXELS)
        ]  # fmt: skip
        np.testing.assert_allclose(raw[channel], sum(one[0] for one in each), atol=1e-9)
        np.testing.assert_allclose(projected[channel], sum(one[1] for one in each), atol=1e-6)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1))
def test_order_of_directions_and_texels_does_not_matter(seed, turn):
    rng, order = np.random.default_rng(seed), np.random.default_rng(turn)
    measured = samples(rng, 10)
    directions_, texels = order.permutation(10), order.permutation(TEXELS)
    here, there = (
        ResidualEquations.of(one, geometry := SampleGeometry.of(one, ResidualBasis.HALF_LIGHT)).fit(
            geometry.power(LOBE), np.stack([LOBE.diffuse, LOBE.specular])
        )
        for one in (
            measured,
            Measurements(
                measured.value[directions_][:, texels], measured.variance[directions_][:, texels],
                measured.light[directions_][:, texels], measured.view[:, texels],
            ),
        )
    )  # fmt: skip
    same = here.rank[texels] == there.rank
    assert same.mean() > 0.9
    np.testing.assert_allclose(there.coefficients[same], here.coefficients[texels][same], atol=1e-4)
