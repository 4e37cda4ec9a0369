"""From counts to radiance: sensors, bracketed exposures, response curves, mosaics, display."""
