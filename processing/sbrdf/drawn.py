"""The measured views as lobes, shadows, shifts and clusters give them back, and how far that is from the BTF."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from processing.products import SbrdfPlus
from processing.products.arrays import Float32, Float64
from processing.products.lafortune import LafortuneTexels
from processing.products.texture import bilinear_taps
from processing.sbrdf.lafortune import FitStatus, LafortuneFit, lafortune_values
from processing.sbrdf.samples import BtfViews, Samples

View = Callable[[int], Float32]


@dataclass(frozen=True, eq=False)
class DrawnLobes:
    """Lobes of every texel under the lights and in the views of a BTF, with a shadow (light, y, x) or without."""

    lobes: LafortuneTexels
    light_directions: Float64
    view_directions: Float64
    shadow: Float32 | None = None

    def seen_from(self, view: int) -> Float32:
        """Reflectance times the cosine to the light of one view under every light, (light, y, x, 3)."""
        light = self.light_directions
        along = np.broadcast_to(self.view_directions[view], light.shape)
        values = lafortune_values(_as_fit(self.lobes), light, along)
        drawn = np.moveaxis(values, 0, 1).reshape(len(light), *self.lobes.shape, 3)
        return drawn if self.shadow is None else drawn * self.shadow[..., None]


@dataclass(frozen=True, eq=False)
class DrawnPlus:
    """An SBRDF+ under its measured lights and in its measured views, without interpolation between these."""

    product: SbrdfPlus

    def seen_from(self, view: int) -> Float32:
        """Reflectance times the cosine to the light of one view under every light, (light, y, x, 3)."""
        product = self.product
        light = product.lights.directions
        top = DrawnLobes(product.lobes, light, product.views.directions, product.shadow).seen_from(view)
        moved = _moved(top, product.shift[view])
        hidden = product.hidden[view]
        cosine = np.maximum(light[:, 2], 0).astype(np.float32)
        moved[:, hidden] = product.centres[product.cluster[view][hidden]].swapaxes(0, 1) * cosine[:, None, None]
        return moved


@dataclass(frozen=True, eq=False)
class ViewErrors:
    """Of every view (view,): squared error and squares of the measured samples, reflectance times cosine, summed."""

    squared_error: Float64
    squares: Float64

    def relative(self, views: slice | np.ndarray = slice(None)) -> float:
        """Squared error over squares, of some views together; NaN where nothing was measured."""
        squares = self.squares[views].sum()
        return float(self.squared_error[views].sum() / squares) if squares > 0 else float("nan")


def view_errors(btf: BtfViews, drawn: View, views: Iterable[int] | None = None) -> ViewErrors:
    """How far `drawn`, as `seen_from` of the classes above, is from the BTF; missing samples do not count."""
    samples = Samples(btf, 1.0)
    errors = np.zeros((2, samples.shape[1]))
    for view in range(samples.shape[1]) if views is None else views:
        seen = samples.seen_from(view)
        off = (drawn(view) - seen).astype(np.float64)
        errors[:, view] = np.nansum(off * off), np.nansum(np.square(seen, dtype=np.float64))
    return ViewErrors(*errors)


def _moved(values: Float32, shift: Float32) -> Float32:
    """Values (light, y, x, 3) at the texels to which shifts (y, x, 2) lead, between them bilinear; the tile repeats."""
    lights, height, width, _ = values.shape
    rows, columns = np.mgrid[:height, :width]
    place = (np.stack([columns, rows], axis=-1) + 0.5 + shift) / (width, height)
    rows, columns, weights = bilinear_taps(place.reshape(-1, 2), height, width, wrap=True)
    taps = weights.astype(np.float32)[:, :, None]
    moved = sum(values[:, rows[:, tap], columns[:, tap]] * taps[:, tap] for tap in range(4))
    return np.asarray(moved, np.float32).reshape(lights, height, width, 3)


def _as_fit(lobes: LafortuneTexels) -> LafortuneFit:
    texels = lobes.shape[0] * lobes.shape[1]
    fields = (lobes.diffuse, lobes.axis, lobes.exponent, lobes.albedo)
    diffuse, axis, exponent, albedo = (one.reshape(texels, *one.shape[2:]) for one in fields)
    status, cost = np.full(texels, FitStatus.CONVERGED, np.int8), np.zeros(texels, np.float32)
    return LafortuneFit(diffuse, axis, exponent, albedo, status, cost, np.zeros(texels, np.int32))
