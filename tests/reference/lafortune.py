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
