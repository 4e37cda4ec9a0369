"""Representations of a BTF at several sizes, each made from the same measured one and asked for what a view sees.

Values are reflectance times the light's cosine, as the eye has them. Coefficients of linear methods are half floats,
and rounded to them; those of lobes are as large as the product stores them.
"""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.materials.srf import fit_phong_to_btf, fit_srf_to_btf
from processing.products import Btf, FactoredBtf, ResidualBasis, Srf
from processing.sbrdf.samples import Samples
from processing.svd import TexelFactors, factor_btf, factor_texels
from tests.benchmarks.yardsticks.local_pca import LocalPca, local_pca

Array = NDArray[Any]

HALF_BYTES = 2
LOBE_VALUES = 7  # of the one lobe of an SRF
MOST_TERMS = 64  # of an SVD; clusters are formed among them
NOT_DRAWN = "the preview has no shader for it"


@dataclass(frozen=True, eq=False)
class Represented:
    """A BTF in few bytes: `seen_from(view)` is (light, y, x, 3), `seconds` what its making took.

    `method` is the family, `size` which of it. `drawn` is what the preview draws, or why it does not.
    """

    method: str
    size: str
    seen_from: Callable[[int], Array]
    size_bytes: int
    seconds: float
    drawn: Any = NOT_DRAWN


def timed(work: Callable[[], Any]) -> tuple[Any, float]:
    """What it makes, and how long that took."""
    begun_s = time.perf_counter()
    made = work()
    return made, time.perf_counter() - begun_s


@dataclass(frozen=True, eq=False)
class Given:
    """What methods start from: the measured BTF, and the same with the cosine inside."""

    btf: Btf

    @cached_property
    def cosine(self) -> Btf:
        """Reflectance times the cosine to the light, in a BTF's form."""
        factor = np.maximum(self.btf.light_directions[:, 2], 0.0).astype(np.float32)[:, None, None, None, None]
        return Btf(self.btf.reflectance * factor, self.btf.light_directions, self.btf.view_directions)

    @cached_property
    def samples(self) -> Samples:
        """As the analysis sees them."""
        return Samples.of(self.btf)

    @cached_property
    def factors(self) -> tuple[TexelFactors, float]:
        """Its strongest terms as the streamed SVD finds them, and the seconds that it took."""
        found: tuple[TexelFactors, float] = timed(lambda: factor_texels(self.cosine, self.most_terms))
        return found

    @property
    def most_terms(self) -> int:
        """Of the SVD: of few texels an eighth of what they have at most."""
        return min(MOST_TERMS, max(self.texels // 8, 1))

    @property
    def values_per_term(self) -> int:
        """Of a map and a function."""
        return self.texels + int(np.prod(self.btf.shape)) // self.texels

    @cached_property
    def strongest(self) -> Array:
        """Squared singular values (n,) of the matrix texel by (light, view, channel), in double precision."""
        gram = np.zeros((self.texels, self.texels))
        for view in range(self.btf.shape[1]):
            seen = np.moveaxis(self.cosine.seen_from(view), 0, 2).reshape(self.texels, -1)
            gram += seen @ seen.T
        return np.maximum(np.linalg.eigvalsh(gram)[::-1], 0)

    @property
    def texels(self) -> int:
        """Number of texels."""
        return self.btf.shape[2] * self.btf.shape[3]


def svd(given: Given, ranks: Iterable[int]) -> Iterator[Represented]:
    """The strongest maps of the matrix texel by (light, view, channel); all ranks from one decomposition."""
    factors, seconds = given.factors
    for rank in ranks:
        size = HALF_BYTES * rank * given.values_per_term
        yield Represented("SVD", f"{rank} terms", _sum_of_products(factors, rank), size, seconds)


def _sum_of_products(factors: TexelFactors, rank: int) -> Callable[[int], Array]:
    maps, functions = _half(factors.maps[:rank]), _half(factors.functions[:rank])
    return lambda view: np.tensordot(functions[:, :, view], maps, (0, 0)).transpose(0, 2, 3, 1)


def svd_by_views(given: Given, ranks: tuple[int, ...]) -> Iterator[Represented]:
    """The product `FactoredBtf`: maps over light and texel, weights over the views."""
    found, seconds = timed(lambda: factor_btf(given.btf, max(ranks)).btf)
    for rank in ranks:
        material = FactoredBtf(found.eigenmaps[:rank], found.weights[:rank], found.lights, found.views)
        size = HALF_BYTES * (material.eigenmaps.size + material.weights.size)
        yield Represented("SVD by views", f"{rank} terms", _sum_over_views(material), size, seconds, material)


def _sum_over_views(found: FactoredBtf) -> Callable[[int], Array]:
    maps, weights = _half(found.eigenmaps), _half(found.weights)
    cosines = np.maximum(found.lights.directions[:, 2], 0.0).astype(np.float32)[:, None, None, None]
    return lambda view: cosines * np.tensordot(weights[:, view], maps, (0, 0))


def clustered(given: Given, sizes: tuple[tuple[int, int], ...]) -> Iterator[Represented]:
    """Clusters of texels and terms for each: local PCA within the strongest terms of the whole."""
    factors, before_s = given.factors
    points = factors.maps.reshape(len(factors.maps), -1).T.astype(np.float64)
    functions = factors.functions.reshape(len(factors.maps), -1)
    for clusters, terms in sizes:
        found, seconds = timed(lambda c=clusters, k=terms: local_pca(points, c, k))
        values = clusters * (terms + 1) * functions.shape[1] + given.texels * terms
        seen = _of_clusters(found, points, functions, given.btf.shape)
        yield Represented("local PCA", f"{clusters} clusters of {terms} terms", seen,
                          HALF_BYTES * values + given.texels, before_s + seconds)  # fmt: skip


def _of_clusters(found: LocalPca, points: Array, functions: Array, shape: tuple[int, ...]) -> Callable[[int], Array]:
    lights, views, height, width, channels = shape
    weights = _half(found.weights(points))
    factors = np.concatenate([np.ones((len(weights), 1), np.float32), weights], axis=1)
    own = _half(np.concatenate([found.mean[:, None], found.basis], axis=1) @ functions)
    own = own.reshape(*own.shape[:2], lights, views, channels)

    def seen(view: int) -> Array:
        out = np.empty((len(factors), lights * channels), np.float32)
        for cluster, basis in enumerate(own):
            of_it = found.label == cluster
            out[of_it] = factors[of_it] @ basis[:, :, view].reshape(len(basis), -1)
        return out.reshape(height, width, lights, channels).transpose(2, 0, 1, 3)

    return seen


def ptm(given: Given) -> Represented:
    """A biquadratic polynomial of the light for each texel and channel, the same from all views."""
    return _ptm(given, "PTM", np.zeros(given.btf.shape[1], int), lambda: given.cosine.reflectance.mean(axis=1)[:, None])


def ptm_per_view(given: Given) -> Represented:
    """A biquadratic polynomial of the light for each texel, view and channel (Malzbender et al. 2001)."""
    return _ptm(given, "PTM per view", np.arange(given.btf.shape[1]), lambda: given.cosine.reflectance)


def _ptm(given: Given, name: str, which: Array, pictures: Callable[[], Array]) -> Represented:
    """Least squares over the lights of pictures (light, picture, y, x, 3), of which each view has one."""
    light = given.btf.light_directions
    functions = ResidualBasis.BIQUADRATIC.evaluate(light, light).astype(np.float32)
    solve = np.linalg.pinv(functions)
    found, seconds = timed(lambda: _half(np.tensordot(solve, pictures(), 1)))
    return Represented(name, "6 terms", lambda view: np.tensordot(functions, found[:, which[view]], 1),
                       HALF_BYTES * found.size, seconds)  # fmt: skip


def srf(given: Given) -> Represented:
    """One lobe for all texels and a residual for each, of the basis that comes nearest to BTFs: it knows the view."""
    fit, seconds = timed(lambda: fit_srf_to_btf(given.btf, basis=ResidualBasis.BILINEAR))
    size = HALF_BYTES * (fit.srf.residual.size + LOBE_VALUES)
    return Represented("SRF", "9 terms", _of_srf(fit.srf, given.btf), size, seconds, fit.srf)


def phong(given: Given) -> Represented:
    """One lobe for all."""
    fit, seconds = timed(lambda: fit_phong_to_btf(given.btf).phong)
    empty = Srf(np.zeros((3, *given.btf.shape[2:4], 3), np.float32), fit, wrap=True)
    return Represented("one lobe", "Phong", _of_srf(empty, given.btf), HALF_BYTES * LOBE_VALUES, seconds)


def _of_srf(found: Srf, btf: Btf) -> Callable[[int], Array]:
    residual = np.moveaxis(_half(np.nan_to_num(found.residual)), 0, -1)  # (y, x, function, channel)

    def seen(view: int) -> Array:
        light = btf.light_directions
        towards = np.broadcast_to(btf.view_directions[view], light.shape)
        functions = found.basis.evaluate(light, towards).astype(np.float32)
        lobe = found.phong.evaluate(light, towards).astype(np.float32)
        return np.einsum("lk,yxkc->lyxc", functions, residual, optimize=True) + lobe[:, None, None]

    return seen


def _half(values: Array) -> Array:
    return values.astype(np.float16).astype(np.float32)
