"""Lafortune lobes in plain NumPy: values, slopes, and the Gram matrix that the fit's kernel accumulates."""

import numpy as np

LEAST_BASE = 1e-3  # as in the kernel


def values(diffuse, axis, exponent, albedo, light, view):
    """Values (t, s, 3), the cosine to the light inside, of texels under directions (s, 3)."""
    base = np.maximum(np.einsum("tji,si->tjs", np.float64(axis), light * view), 0.0)
    lobes = np.einsum("tjs,tjc->tsc", base ** np.float64(exponent)[..., None], np.float64(albedo))
    above = (light[:, 2] > 0) & (view[:, 2] > 0)
    return np.where(above, light[:, 2], 0.0)[:, None] * (np.float64(diffuse)[:, None] + lobes)


def columns(products, factor, lobes, held):
    """F g and its derivatives by log n and the two components of C that are not held, (4 j, s)."""
    rows = []
    for (*axis, n), fixed in zip(lobes, held, strict=True):
        base = np.array(axis) @ products
        safe = np.maximum(base, LEAST_BASE)
        value = np.where(base > LEAST_BASE, safe**n, 0.0) * factor
        slope = n * value / safe
        rows += [value, n * np.log(safe) * value, *(slope * products[(fixed + k) % 3] for k in (1, 2))]
    return np.array(rows)


def gram(products, factor, samples, lobes, held, albedo):
    """Inner products of the three residuals, F, and the columns of the lobes; `samples` (3, s)."""
    basis = columns(products, factor, lobes, held)
    residuals = samples - albedo[:, :1] * factor - albedo[:, 1:] @ basis[::4]
    rows = np.concatenate([residuals, factor[None], basis])
    return rows @ rows.T


def materials(rng, texels, lobes=3, shared=False):
    """Diffuse, axis, exponent, albedo in float32: lobes forward and back, from broad ones to the directions' limit."""
    axis = np.concatenate([rng.uniform(0.7, 1, (texels, lobes, 2)), rng.uniform(0.3, 1, (texels, lobes, 1))], axis=2)
    axis[..., :2] *= np.where(rng.random((texels, lobes, 1)) < 0.75, -1, 1)
    axis /= np.abs(axis).max(axis=2, keepdims=True)
    exponent = np.exp(rng.uniform(np.log(1.5), np.log(60), (texels, lobes)))
    diffuse, albedo = rng.uniform(0.02, 0.4, (texels, 3)), rng.uniform(0.05, 1, (texels, lobes, 3))
    if shared:
        axis[:], diffuse[:] = axis[:, :1], diffuse[:, :1]
    return tuple(one.astype(np.float32) for one in (diffuse, axis, exponent, albedo))


def odd_texels(light, view):
    """Values (1, s, 3) under directions (s, 3) by name, and whether the fit is given a start."""
    rng, count = np.random.default_rng(7), len(light)
    plain = values(*materials(rng, 1), light, view)
    noisy = plain + 0.002 * rng.normal(size=plain.shape)
    flat = np.where(light[:, 2:] > 0, light[:, 2:], 0)[None] * np.array([0.3, 0.2, 0.1])
    few, hole, channel, infinite, shadowed = (noisy.copy() for _ in range(5))
    few[:, 3:], hole[:, 5, 1], infinite[:, 4] = np.nan, np.nan, np.inf
    channel[:, rng.random(count) < 0.5, 2] = np.nan
    shadowed[:, rng.random(count) < 0.3] = 0
    made = {
        "matt": flat,
        "matt, with noise": flat + 0.002 * rng.normal(size=flat.shape),
        "black": 0 * flat,
        "below zero": -flat,
        "nothing but noise": 0.002 * rng.normal(size=flat.shape),
        "one sample not a number": hole,
        "one sample infinite": infinite,
        "one channel missing in half of the samples": channel,
        "three samples": few,
        "no sample": np.nan * flat,
        "mirror": _one_lobe((-1, -1, 1), 2000, light, view),
        "broad lobe": _one_lobe((0, 0, 1), 0.2, light, view),
        "twin lobes": _one_lobe((-1, -1, 0.7), 12, light, view) * 2,
        "times a million": 1e6 * noisy,
        "over a million": 1e-6 * noisy,
        "largest numbers": 1e37 * noisy,
        "smallest numbers": 1e-38 * noisy,
        "a third in shadow": shadowed,
        "saturated": np.minimum(noisy, 0.3),
        "one sample a million times the others": np.where(np.arange(count)[:, None] == 7, 1e6, noisy),
    }
    found = {name: (one.astype(np.float32), False) for name, one in made.items()}
    return found | {"from a start that sees nothing": (made["matt"].astype(np.float32), True)}


def _one_lobe(axis, exponent, light, view):
    material = np.full((1, 3), 0.1), np.array([[axis]]), np.array([[exponent]]), np.full((1, 1, 3), 0.5)
    return values(*material, light, view)
