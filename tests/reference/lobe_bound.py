"""Cramer-Rao bounds of a lobe and a residual s . H, from dense matrices: no code of the fits."""

import numpy as np


def columns(lobe, cos_light, half):
    """Derivatives (3, direction, texel) of f by k_d, k_s and n, the latter for k_s = 1."""
    cos_half = np.maximum(half[..., 2], 1e-300)
    power = cos_half**lobe.exponent
    return np.stack([cos_light, power, power * np.log(cos_half)])


def bounds(lobe, cos_light, half, deviation):
    """Covariances of [k_d (3), k_s (3), n] (7, 7) and, summed over its components, of each s (texel, 3).

    `half` is (direction, texel, 3), `cos_light` (direction, texel), the noise has one `deviation`. s counts within the
    plane that its half vectors span to a hundredth.
    """
    slopes, lit = columns(lobe, cos_light, half), cos_light > 0
    information, each = np.zeros((7, 7)), []
    for texel in range(cos_light.shape[1]):
        rows = half[lit[:, texel], texel] / deviation
        inverse = np.linalg.pinv(rows, rcond=0.01)
        own = slopes[:, lit[:, texel], texel].T / deviation
        left = own - rows @ (inverse @ own)
        each.append((np.trace(inverse @ inverse.T), inverse @ own))
        for channel in range(3):
            index = np.array([channel, 3 + channel, 6])
            scale = np.array([1.0, 1.0, lobe.specular[channel]])
            information[np.ix_(index, index)] += (left * scale).T @ (left * scale)
    covariance = np.linalg.inv(information)
    residual = np.empty((len(each), 3))
    for texel, (noise, carried) in enumerate(each):
        for channel in range(3):
            index = np.array([channel, 3 + channel, 6])
            jacobian = carried * np.array([1.0, 1.0, lobe.specular[channel]])
            residual[texel, channel] = noise + np.trace(jacobian @ covariance[np.ix_(index, index)] @ jacobian.T)
    return covariance, residual
