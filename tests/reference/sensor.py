"""A simulated sensor's forward model turned round: what its counts mean, exactly."""

import numpy as np


def linear_dn(counts, unit):
    """Counts over black without the unit's offset pattern and compression; solves y = u (1 - c u^2) by Newton."""
    sensor = unit.sensor
    span = sensor.white_dn - sensor.black_dn
    counted = (np.asarray(counts, float) - sensor.black_dn - unit.offset_dn) / span
    share = counted.copy()
    for _ in range(4):
        share -= (share * (1 - sensor.compression * share**2) - counted) / (1 - 3 * sensor.compression * share**2)
    return share * span


def electrons(counts, unit):
    """Electrons of counts (..., h, w), read noise and rounding still in them."""
    return linear_dn(counts, unit) * unit.sensor.gain_e_per_dn
