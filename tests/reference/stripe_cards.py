"""A laser plane swept over rows of a card: a forward model from first principles, and the bound on its pulse times.

In a cross-section the camera looks straight down (orthographic, columns along x), the laser plane leans by the
triangulation angle: at time t, in frames, its middle is where x + z tan(angle) = advance t. Its irradiance is Gaussian
over the perpendicular distance. A pixel integrates over its footprint, an edge of the albedo within it included, and
over the shutter's time. Noise: speckle, photons, read noise, rounding, clipping. Nothing of processing is used.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import erf

CELLS = 16  # per pixel, of the albedo and of the light
BOUND_ROWS = 8


@dataclass(frozen=True)
class Camera:
    """Black and white level, electrons per count, read noise."""

    black_dn: float = 256.0
    white_dn: float = 4095.0
    gain_e_per_dn: float = 4.0
    read_noise_e: float = 4.0

    @property
    def full_e(self):
        return (self.white_dn - self.black_dn) * self.gain_e_per_dn

    def counts(self, electrons, rng):
        """Frames of mean electrons (...) in raw_dn."""
        noisy = rng.poisson(electrons) + rng.normal(0, self.read_noise_e, electrons.shape)
        return self.without_noise(noisy)

    def without_noise(self, electrons):
        raw = np.rint(electrons / self.gain_e_per_dn + self.black_dn)
        return np.clip(raw, 0, self.white_dn).astype(np.uint16)


@dataclass(frozen=True)
class Card:
    """A card of `rows` independent rows about x = 0, and the sweep over it.

    `peak_e`: electrons in the middle of the stripe on white that faces the laser. `slope_rad`: of the surface z(x),
    which faces the laser where it equals the triangulation angle. `ratio`: of the reflectance right of an edge near
    x = 0 to that left of it, which is 1 / ratio; the edge lies elsewhere within its pixel in every row. `texture`:
    standard deviation of the albedo's logarithm, in specks of half a pixel. `exposure_frames`: how long the shutter is
    open. `speckle`: contrast, correlated over `speckle_m` of the stripe's way. `echo`: height of a second, weaker
    stripe that reaches the part that is looked at, and no other, `echo_m` later. `blur_px`: of the lens.
    """

    rows: int = 96
    half_m: float = 0.004  # of the part that is looked at
    pixel_m: float = 0.0005
    angle_rad: float = np.pi / 4
    sigma_m: float = 0.0008
    advance_m: float = 0.00113
    exposure_frames: float = 0.3
    slope_rad: float = 0.0
    ratio: float = 1.0
    texture: float = 0.0
    peak_e: float = 8000.0
    ambient_e: float = 30.0
    speckle: float = 0.0
    speckle_m: float = 0.0008
    echo: float = 0.0
    echo_m: float = 0.006
    blur_px: float = 0.0
    camera: Camera = Camera()

    @property
    def spread(self):
        """Way of the stripe per way along x: 1 on a flat card, more where the surface faces the laser."""
        return 1 + np.tan(self.slope_rad) * np.tan(self.angle_rad)

    @property
    def trace_m(self):
        """The stripe's standard deviation along x as the camera sees it on this surface."""
        return self.sigma_m / np.cos(self.angle_rad) / self.spread

    @cached_property
    def x_m(self):
        """Pixel centres (p,): the part that is looked at, and beyond it as far as the stripe reaches."""
        half = int(np.ceil((self.half_m + 5 * self.trace_m) / self.pixel_m))
        return np.arange(-half, half + 1) * self.pixel_m

    @cached_property
    def looked_at(self):
        """Which of the pixels (p,) count."""
        return np.abs(self.x_m) <= self.half_m + 1e-9

    @property
    def times(self):
        """Frame numbers (t,) less the frame in which the stripe is at x = 0."""
        reach = (self.x_m[-1] * self.spread + 5 * self.sigma_m / np.cos(self.angle_rad)) / self.advance_m
        after = (self.echo_m if self.echo else 0.0) / self.advance_m
        return np.arange(-np.ceil(reach), np.ceil(reach + after) + 1)

    def range_m(self, time, x_m):
        """Height z where the ray at x meets the stripe's middle at a time in frames from x = 0."""
        return (self.advance_m * time - x_m) / np.tan(self.angle_rad)

    def surface_m(self, x_m):
        return x_m * np.tan(self.slope_rad)

    def light(self, way_m):
        """Stripe light on white, mean over the shutter's time, at these ways (...) of its middle from a point."""
        sigma = self.sigma_m / np.cos(self.angle_rad)
        facing = np.cos(self.slope_rad - self.angle_rad)
        half = max(self.exposure_frames * self.advance_m, 1e-3 * sigma) / 2
        passed = erf((way_m + half) / sigma / 2**0.5) - erf((way_m - half) / sigma / 2**0.5)
        return self.peak_e * facing * np.sqrt(np.pi / 8) * sigma / half * passed

    @cached_property
    def albedo(self):
        """Albedo (rows, cells) along x: 1 right of an edge, 1 / ratio left of it, times the texture."""
        edge_m = ((np.arange(self.rows) + 0.5) / self.rows - 0.5)[:, None] * self.pixel_m
        step = np.where(self._cells_m < edge_m, 1 / self.ratio, 1.0)
        specks = np.random.default_rng(0).standard_normal((self.rows, 2 * len(self.x_m)))
        return step * np.exp(self.texture * np.repeat(specks, CELLS // 2, axis=1))

    def electrons(self, shift=0.0):
        """Mean electrons (t, rows, p) of the stripe alone, at `shift` frames after the frames' own times."""
        way = self.advance_m * (self.times[:, None] + shift) - self._cells_m * self.spread
        light = self.light(way)
        if self.echo:
            near = np.abs(self._cells_m) <= self.half_m + self.pixel_m / 2
            light = light + self.echo * near * self.light(way - self.echo_m)
        weighted = np.einsum("rc,cp->rcp", self.albedo, self._footprint)
        return np.einsum("tc,rcp->trp", light, weighted, optimize=True)

    def shoot(self, seed):
        """Frames (t, rows, p) in raw_dn, as a camera would record them."""
        rng = np.random.default_rng(seed)
        stripe = self.electrons()
        if self.speckle:
            stripe = stripe * self._speckle(rng, stripe.shape)
        return self.camera.counts(stripe + self.ambient_e, rng)

    def correlation(self):
        """Correlation (t, t) of a pixel's speckle between frames."""
        apart = np.subtract.outer(self.times, self.times) * self.advance_m
        return np.exp(-0.5 * (apart / self.speckle_m) ** 2)

    def _speckle(self, rng, shape):
        """Factors (t, rows, p) of mean 1: sums of many exponential intensities, so gamma distributed.

        By the cube of a Gaussian (Wilson and Hilferty 1931), which is correlated over the stripe's way.
        """
        root = np.linalg.cholesky(self.correlation() + 1e-9 * np.eye(shape[0]))
        gaussian = np.tensordot(root, rng.standard_normal(shape), 1)
        return np.maximum(1 - self.speckle**2 / 9 + self.speckle / 3 * gaussian, 0) ** 3

    @cached_property
    def _cells_m(self):
        count = len(self.x_m) * CELLS
        return (np.arange(count) + 0.5 - count / 2) * self.pixel_m / CELLS

    @cached_property
    def _footprint(self):
        """Share (cells, p) of each cell's light in each pixel: a box, blurred by the lens."""
        apart = (self._cells_m[:, None] - self.x_m) / self.pixel_m
        if not self.blur_px:
            return (np.abs(apart) < 0.5) / CELLS
        root = 2**0.5 * self.blur_px
        return (erf((apart + 0.5) / root) - erf((apart - 0.5) / root)) / 2 / CELLS


def range_bound_m(card):
    """Root mean square of the bound on the range over the pixels that are looked at, on at most BOUND_ROWS rows."""
    deviation = time_bound(replace(card, rows=min(card.rows, BOUND_ROWS)))
    return float(np.sqrt(np.mean(deviation**2))) * card.advance_m / np.tan(card.angle_rad)


def time_bound(card):
    """Cramer-Rao deviation (rows, p) of the pulse time, in frames, of the pixels that are looked at.

    Gaussian noise of the frames' covariance: photons and ambient light, read noise, rounding, and the speckle's own.
    Time, height and background are unknown, the pulse's shape and the speckle's correlation known. Saturated samples
    tell nothing, a second stripe is not there.
    """
    single, step = replace(card, echo=0.0), 1e-3
    mean = single.electrons()
    by_time = (single.electrons(-step) - single.electrons(step)) / (2 * step)
    pixels = np.stack([mean, by_time])[..., card.looked_at]
    shape = pixels.shape[2:]
    different, index = np.unique(pixels.reshape(*pixels.shape[:2], -1), axis=2, return_inverse=True)
    deviation = [pulse_bound(single, m, np.stack([t, m, np.ones_like(m)])) for m, t in np.moveaxis(different, 2, 0)]
    return np.array(deviation)[index.ravel()].reshape(shape)


def pulse_bound(card, mean, slopes):
    """Deviation of the first parameter from one pixel's mean (t,) and its derivatives (k, t) by the parameters."""
    kept = mean + card.ambient_e < card.camera.full_e
    mean, slopes = mean[kept], slopes[:, kept]
    shared = card.speckle**2 * card.correlation()[np.ix_(kept, kept)]
    covariance = noise_covariance(card, mean, shared)
    inverse = np.linalg.inv(covariance)
    pairs = [(s, s * (k != 2)) for k, s in enumerate(slopes)]  # speckle is the stripe's alone, not the background's
    changes = [inverse @ (np.diag(s) + shared * (np.outer(r, mean) + np.outer(mean, r))) for s, r in pairs]
    noise = 0.5 * np.array([[np.sum(a * b.T) for b in changes] for a in changes])
    information = slopes @ inverse @ slopes.T + noise
    scale = np.sqrt(np.diag(information))
    return float(np.sqrt(np.linalg.inv(information / np.outer(scale, scale))[0, 0]) / scale[0])


def noise_covariance(card, mean, shared):
    """Covariance (t, t) of one pixel's electrons: independent noise, and the speckle's `shared` part."""
    own = mean + card.ambient_e + card.camera.read_noise_e**2 + card.camera.gain_e_per_dn**2 / 12
    return np.diag(own) + shared * np.outer(mean, mean)
