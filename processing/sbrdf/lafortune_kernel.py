"""Loops over the samples of one texel under the Lafortune fit, which the compiler vectorises.

Samples come in blocks of `BLOCK`, padded by zeros, as rows of one flat array: the products L_i V_i, the factor F (the
cosine to the light over the noise), and three channels (over the noise). Of a lobe four columns are needed: F g, and
F times the derivatives of g = (C . P)^n by log n and by the two components of C that are not held at +-1. None depends
on the channel, so that one Gram matrix of residuals and columns serves all three.

numba's build calls the scalar pow, so that the power is 2^(n log2 b) by two polynomials. All is float32 within a block;
blocks are added in float64.
"""

import numba
import numpy as np
from numpy.typing import NDArray

from processing.products.arrays import Float32, Float64

BLOCK = 512
ROWS = 7  # of samples: products, factor, values
TILE = 4  # columns of a lobe; of the residuals and F
FACTOR, VALUES = 3 * BLOCK, 4 * BLOCK

FAST = {"reassoc", "contract", "nsz", "arcp"}
_I32, _F32 = np.int32, np.float32
_ZERO, _ONE, _HALF = _F32(0.0), _F32(1.0), _F32(0.5)
_LEAST_BASE = _F32(1e-3)  # where the slopes of a lobe with n < 1 stop to grow
_LEAST_POWER = _F32(-40.0)  # of two; below it a lobe is 0, as products of smaller numbers are slow
_MANTISSA, _BIAS = _I32(23), _I32(127)
_ROOT_HALF = _I32(0x3F3504F3)
_LN2 = _F32(np.log(2.0))
# log2(1 + f) / f on [sqrt(1/2) - 1, sqrt(2) - 1] to 3e-8, and 2^f on [-1/2, 1/2] to 8e-8: least maximum of the error
_L0, _L1, _L2 = _F32(1.4426950036522026), _F32(-0.7213473468338631), _F32(0.48091064301416747)
_L3, _L4, _L5 = _F32(-0.36070368019179944), _F32(0.28791624352944856), _F32(-0.23894487762134384)
_L6, _L7, _L8 = _F32(0.2157157094505465), _F32(-0.20726939759220436), _F32(0.12583630654298156)
_E0, _E1, _E2 = _F32(1.0000000716545443), _F32(0.6931469670603922), _F32(0.2402211972429801)
_E3, _E4, _E5 = _F32(0.05550713280633264), _F32(0.00967554131605713), _F32(0.0013276469685936996)


@numba.njit(nogil=True, cache=True, fastmath=FAST, error_model="numpy", inline="always")
def _log2(x: np.float32) -> np.float32:
    """Logarithm to base 2 of x > 0."""
    bits = np.float32(x).view(np.int32)
    power = (bits - _ROOT_HALF) >> _MANTISSA
    f = np.int32(bits - (power << _MANTISSA)).view(np.float32) - _ONE
    high = _L4 + f * (_L5 + f * (_L6 + f * (_L7 + f * _L8)))
    return _F32(power) + f * (_L0 + f * (_L1 + f * (_L2 + f * (_L3 + f * high))))


@numba.njit(nogil=True, cache=True, fastmath=FAST, error_model="numpy", inline="always")
def _exp2(x: np.float32) -> np.float32:
    """2^x for x <= 0."""
    x = x if x > _LEAST_POWER else _LEAST_POWER
    power = _I32(x - _HALF)
    f = x - _F32(power)
    two = np.int32((power + _BIAS) << _MANTISSA).view(np.float32)
    return two * (_E0 + f * (_E1 + f * (_E2 + f * (_E3 + f * (_E4 + f * _E5)))))


@numba.njit(nogil=True, cache=True, fastmath=FAST, error_model="numpy")
def _lobe_columns(block: Float32, others: tuple[Float32, Float32], lobe: Float64, columns: Float32) -> None:
    """The four columns of a lobe (C_x, C_y, C_z, n); `others` are the products of the components that are not held."""
    cx, cy, cz, n = _F32(lobe[0]), _F32(lobe[1]), _F32(lobe[2]), _F32(lobe[3])
    first, second = others
    for i in range(BLOCK):
        base = cx * block[i] + cy * block[BLOCK + i] + cz * block[2 * BLOCK + i]
        safe = base if base > _LEAST_BASE else _LEAST_BASE
        power = n * _log2(safe)
        value = _exp2(power) * block[FACTOR + i]
        value = value if (base > _LEAST_BASE) & (power > _LEAST_POWER) else _ZERO
        slope = n * value / safe
        columns[i] = value
        columns[BLOCK + i] = _LN2 * power * value
        columns[2 * BLOCK + i] = slope * first[i]
        columns[3 * BLOCK + i] = slope * second[i]


@numba.njit(nogil=True, cache=True, fastmath=FAST, error_model="numpy")
def _begin_residuals(block: Float32, albedo: Float64, residuals: Float32) -> None:
    """The values less the diffuse, and F."""
    r, g, b = _F32(albedo[0, 0]), _F32(albedo[1, 0]), _F32(albedo[2, 0])
    for i in range(BLOCK):
        factor = block[FACTOR + i]
        residuals[i] = block[VALUES + i] - r * factor
        residuals[BLOCK + i] = block[VALUES + BLOCK + i] - g * factor
        residuals[2 * BLOCK + i] = block[VALUES + 2 * BLOCK + i] - b * factor
        residuals[3 * BLOCK + i] = factor


@numba.njit(nogil=True, cache=True, fastmath=FAST, error_model="numpy")
def _subtract_lobe(lobe: Float32, albedo: Float64, residuals: Float32) -> None:
    r, g, b = _F32(albedo[0]), _F32(albedo[1]), _F32(albedo[2])
    for i in range(BLOCK):
        residuals[i] -= r * lobe[i]
        residuals[BLOCK + i] -= g * lobe[i]
        residuals[2 * BLOCK + i] -= b * lobe[i]


@numba.njit(nogil=True, cache=True, fastmath=FAST, error_model="numpy")
def _add_tile(a: Float32, b: Float32, gram: Float64) -> None:
    """Add the inner products of four columns with four others."""
    s00 = s01 = s02 = s03 = s10 = s11 = s12 = s13 = _ZERO
    s20 = s21 = s22 = s23 = s30 = s31 = s32 = s33 = _ZERO
    for i in range(BLOCK):
        b0, b1, b2, b3 = b[i], b[BLOCK + i], b[2 * BLOCK + i], b[3 * BLOCK + i]
        a0 = a[i]
        s00 += a0 * b0
        s01 += a0 * b1
        s02 += a0 * b2
        s03 += a0 * b3
        a1 = a[BLOCK + i]
        s10 += a1 * b0
        s11 += a1 * b1
        s12 += a1 * b2
        s13 += a1 * b3
        a2 = a[2 * BLOCK + i]
        s20 += a2 * b0
        s21 += a2 * b1
        s22 += a2 * b2
        s23 += a2 * b3
        a3 = a[3 * BLOCK + i]
        s30 += a3 * b0
        s31 += a3 * b1
        s32 += a3 * b2
        s33 += a3 * b3
    gram[0, 0] += s00
    gram[0, 1] += s01
    gram[0, 2] += s02
    gram[0, 3] += s03
    gram[1, 0] += s10
    gram[1, 1] += s11
    gram[1, 2] += s12
    gram[1, 3] += s13
    gram[2, 0] += s20
    gram[2, 1] += s21
    gram[2, 2] += s22
    gram[2, 3] += s23
    gram[3, 0] += s30
    gram[3, 1] += s31
    gram[3, 2] += s32
    gram[3, 3] += s33


@numba.njit(nogil=True, cache=True)
def gram_of(
    samples: Float32, lobes: Float64, held: NDArray[np.int64], albedo: Float64, columns: Float32, gram: Float64
) -> None:
    """Inner products (4 + 4 j, 4 + 4 j) of three residuals, F, and each lobe's four columns.

    `samples` are whole blocks; `lobes` (j, 4) as C_x, C_y, C_z, n with the component `held` at +-1; `albedo`
    (3, 1 + j) has the diffuse first; `columns` is room for (4 + 4 j) * BLOCK numbers.
    """
    size, tile = TILE * (1 + len(lobes)), TILE * BLOCK
    gram[:size, :size] = 0.0
    for at in range(0, samples.size, ROWS * BLOCK):
        block = samples[at : at + ROWS * BLOCK]
        _begin_residuals(block, albedo, columns[:tile])
        for j in range(len(lobes)):
            own = columns[(1 + j) * tile : (2 + j) * tile]
            first, second = (held[j] + 1) % 3 * BLOCK, (held[j] + 2) % 3 * BLOCK
            _lobe_columns(block, (block[first : first + BLOCK], block[second : second + BLOCK]), lobes[j], own)
            _subtract_lobe(own[:BLOCK], albedo[:, 1 + j], columns[:tile])
        for p in range(0, size, TILE):
            for q in range(p, size, TILE):
                a, b = columns[p * BLOCK : p * BLOCK + tile], columns[q * BLOCK : q * BLOCK + tile]
                _add_tile(a, b, gram[p : p + TILE, q : q + TILE])
    for p in range(size):
        for q in range(p // TILE * TILE):
            gram[p, q] = gram[q, p]


@numba.njit(nogil=True, cache=True, fastmath=FAST, error_model="numpy")
def _lobe_values(block: Float32, lobe: Float32, out: Float32) -> None:
    cx, cy, cz, n = lobe[0], lobe[1], lobe[2], lobe[3]
    for i in range(BLOCK):
        base = cx * block[i] + cy * block[BLOCK + i] + cz * block[2 * BLOCK + i]
        safe = base if base > _LEAST_BASE else _LEAST_BASE
        power = n * _log2(safe)
        value = _exp2(power) * block[FACTOR + i]
        out[i] = value if (base > _LEAST_BASE) & (power > _LEAST_POWER) else _ZERO


@numba.njit(nogil=True, cache=True, fastmath=FAST, error_model="numpy")
def _sum_up(parts: Float32, weights: Float32, out: Float32) -> None:
    """Pixels (3 n) of F and three lobes (4 * BLOCK) by weights (4, 3)."""
    r0, r1, r2, r3 = weights[0, 0], weights[1, 0], weights[2, 0], weights[3, 0]
    g0, g1, g2, g3 = weights[0, 1], weights[1, 1], weights[2, 1], weights[3, 1]
    b0, b1, b2, b3 = weights[0, 2], weights[1, 2], weights[2, 2], weights[3, 2]
    for i in range(out.size // 3):
        p0, p1, p2, p3 = parts[i], parts[BLOCK + i], parts[2 * BLOCK + i], parts[3 * BLOCK + i]
        out[3 * i] = r0 * p0 + r1 * p1 + r2 * p2 + r3 * p3
        out[3 * i + 1] = g0 * p0 + g1 * p1 + g2 * p2 + g3 * p3
        out[3 * i + 2] = b0 * p0 + b1 * p1 + b2 * p2 + b3 * p3


@numba.njit(nogil=True, cache=True)
def values_of(blocks: Float32, weights: Float32, lobes: Float32, out: Float32) -> None:
    """Values (t, 3 s) of texels with three lobes (t, 3, 4) as C, n; `weights` (t, 4, 3) has the diffuse first.

    `blocks` are rows of samples without values: four a block.
    """
    count, width = out.shape[1] // 3, 4 * BLOCK
    parts = np.zeros(width, np.float32)
    for texel in range(len(out)):
        for number in range((count + BLOCK - 1) // BLOCK):
            block, start = blocks[number * width : (number + 1) * width], number * BLOCK
            parts[:BLOCK] = block[FACTOR:]
            for j in range(3):
                if weights[texel, 1 + j].any():
                    _lobe_values(block, lobes[texel, j], parts[(1 + j) * BLOCK : (2 + j) * BLOCK])
            _sum_up(parts, weights[texel], out[texel, 3 * start : 3 * min(start + BLOCK, count)])


@numba.njit(nogil=True, cache=True)
def candidate_values(samples: Float32, lobes: Float64) -> Float32:
    """F g of lobes (k, 4) as C, n: (block, k, BLOCK)."""
    width = ROWS * BLOCK
    out = np.empty((samples.size // width, len(lobes), BLOCK), np.float32)
    for number in range(len(out)):
        for k in range(len(lobes)):
            _lobe_values(samples[number * width : (number + 1) * width], lobes[k].astype(np.float32), out[number, k])
    return out


@numba.njit(nogil=True, cache=True)
def candidate_products(samples: Float32, values: Float32, lobes: Float64, albedo: Float64) -> tuple[Float64, Float64]:
    """Inner products of three residuals, F, three lobes (j, 4) as C, n, and a zero with candidates: (8, 8 + k).

    The first 8 columns are those among themselves. `values` (block, k, BLOCK), k a multiple of 4, are those of
    `candidate_values`; `albedo` (3, 1 + j). The second result (k,) are the candidates' squares.
    """
    count, width, tile = values.shape[1], ROWS * BLOCK, TILE * BLOCK
    products, squares, own = np.zeros((2 * TILE, 2 * TILE + count)), np.zeros(count), np.zeros((TILE, TILE))
    parts = np.zeros(2 * tile, np.float32)
    for number in range(len(values)):
        block = samples[number * width : (number + 1) * width]
        _begin_residuals(block, albedo, parts[:tile])
        for j in range(len(lobes)):
            value = parts[tile + j * BLOCK : tile + (j + 1) * BLOCK]
            _lobe_values(block, lobes[j].astype(np.float32), value)
            _subtract_lobe(value, albedo[:, 1 + j], parts[:tile])
        for row in range(2):
            part, sums = parts[row * tile : (row + 1) * tile], products[row * TILE : (row + 1) * TILE]
            for other in range(2):
                _add_tile(part, parts[other * tile : (other + 1) * tile], sums[:, other * TILE : (other + 1) * TILE])
            for k in range(0, count, TILE):
                _add_tile(part, values[number, k : k + TILE].ravel(), sums[:, (2 * TILE) + k : 3 * TILE + k])
        for k in range(0, count, TILE):
            four = values[number, k : k + TILE].ravel()
            own[:, :] = 0.0
            _add_tile(four, four, own)
            for i in range(TILE):
                squares[k + i] += own[i, i]
    return products, squares
