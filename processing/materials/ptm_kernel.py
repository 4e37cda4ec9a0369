"""Loops of the fit of relightable images, compiled by numba: every value by one matrix, then those that lack a light.

Values are (light, n): n is every pixel's every channel. The fast loop reads them once, in tiles that stay in the cache,
and is as exact as single precision allows because few products are added up before they enter a sum. A value that is
not finite makes its coefficients not finite: the second loop finds those and solves them from the lights that are left.
"""

import numba
import numpy as np
from numpy.typing import NDArray

from processing.products.arrays import Float32, Float64
from processing.threads import in_parts

TOGETHER = 8  # lights whose products are added up at a time
_TILE = 1024  # values of these lights, widened, are 32 KiB
_CHUNK = 4096

FITTED, RANK_DEFICIENT, TOO_FEW, NO_VALUES = 0, 1, 2, 3


@numba.njit(cache=True, inline="never")
def _widen(source: NDArray[np.generic], target: Float32) -> None:
    for i in range(len(target)):
        target[i] = np.float32(source[i])


@numba.njit(cache=True, inline="never", fastmath={"contract"})
def _add_products(total: Float32, m: Float32, rows: tuple[Float32, ...]) -> None:
    a, b, c, d, e, f, g, h = rows
    m0, m1, m2, m3, m4, m5, m6, m7 = m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7]
    for i in range(len(total)):
        first = m3 * d[i] + (m2 * c[i] + (m1 * b[i] + m0 * a[i]))
        total[i] += m7 * h[i] + (m6 * g[i] + (m5 * f[i] + (m4 * e[i] + first)))


@numba.njit(cache=True, parallel=True)
def apply(values: NDArray[np.generic], matrix: Float32, out: Float32) -> None:
    """`out` (k, n) = `matrix` (k, light) @ `values` (light, n); the matrix has zeros up to a multiple of `TOGETHER`."""
    lights, count = values.shape
    for tile in numba.prange((count + _TILE - 1) // _TILE):
        start, stop = tile * _TILE, min((tile + 1) * _TILE, count)
        wide = np.zeros((TOGETHER, stop - start), np.float32)
        rows = (wide[0], wide[1], wide[2], wide[3], wide[4], wide[5], wide[6], wide[7])
        sums = np.zeros((len(matrix), stop - start), np.float32)
        for first in range(0, lights, TOGETHER):
            here = min(TOGETHER, lights - first)
            for j in range(here):
                _widen(values[first + j, start:stop], wide[j])
            wide[here:] = 0
            for k in range(len(matrix)):
                _add_products(sums[k], matrix[k, first : first + TOGETHER], rows)
        out[:, start:stop] = sums


@numba.njit(cache=True)
def _shortest(functions: Float64, used: NDArray[np.bool_], tolerance: float) -> tuple[Float64, int]:
    """Matrix (k, light) that gives the shortest least-squares solution over the lights that are `used`, and its rank.

    Singular values under `tolerance` of the largest count as zero.
    """
    size = functions.shape[1]
    kept = functions * used.reshape(-1, 1)
    squares, axes = np.linalg.eigh(kept.T @ kept)
    inverse, rank = np.zeros((size, size)), 0
    for k in range(size):
        if squares[k] > tolerance * tolerance * squares[-1]:
            for i in range(size):
                for j in range(size):
                    inverse[i, j] += axes[i, k] * axes[j, k] / squares[k]
            rank += 1
    return inverse @ kept.T, rank


@numba.njit(cache=True)
def _solve_column(values: Float32, used: NDArray[np.bool_], matrix: Float64, out: Float32) -> None:
    for k in range(len(out)):
        total = 0.0
        for light in range(len(used)):
            if used[light]:
                total += matrix[k, light] * values[light]
        out[k] = total


@numba.njit(cache=True)
def _all_finite(values: Float32) -> bool:
    for value in values:
        if not np.isfinite(value):
            return False
    return True


@numba.njit(nogil=True, cache=True)
def _solve_run(values: Float32, functions: Float64, tolerance: float, out: Float32, status: NDArray[np.uint8]) -> None:
    (lights, count), size = values.shape, functions.shape[1]
    used, finite = np.zeros(lights, np.bool_), np.zeros(lights, np.bool_)
    matrix, rank = np.zeros((size, lights)), 0
    for column in range(count):
        if _all_finite(out[:, column]):
            continue
        for light in range(lights):
            finite[light] = np.isfinite(values[light, column])
        if not np.array_equal(finite, used):
            used[:] = finite
            if used.any():
                matrix, rank = _shortest(functions, used, tolerance)
        out[:, column] = 0
        if not used.any():
            status[column] = NO_VALUES
            continue
        _solve_column(values[:, column], used, matrix, out[:, column])
        status[column] = FITTED if rank == size else (RANK_DEFICIENT if used.sum() >= size else TOO_FEW)


def solve_gaps(values: Float32, functions: Float64, tolerance: float, out: Float32, status: NDArray[np.uint8]) -> None:
    """Solve again those columns of `out` (k, n) that are not finite, from the finite values, and say how in `status`.

    A run of values that lack the same lights, as the channels of a pixel mostly do, shares one decomposition.
    """

    def part(first: int, stop: int) -> None:
        some = slice(first, stop)
        _solve_run(values[:, some], functions, tolerance, out[:, some], status[some])

    in_parts(part, values.shape[1], _CHUNK)
