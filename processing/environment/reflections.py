"""Reflections of the lens's own frame: found by what front and back pictures have in common, or told by a person."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, fft, idct, ifft
from scipy.ndimage import (
    binary_dilation,
    binary_erosion,
    distance_transform_edt,
    find_objects,
    gaussian_filter,
    label,
    map_coordinates,
    mean,
)

from processing.environment.frame_sectors import sectors_of_ring
from processing.environment.image_circle import ImageCircle
from processing.environment.ring import RingGrid, ring_grid
from processing.environment.sector_fit import sectors_and_outlines
from processing.errors import ImageError
from processing.products.arrays import Float64

Mask = NDArray[np.bool_]
_BLUR_PX = 1.0
_LAMP = 20.0  # times the mean light: no frame mirrors as much, and a lamp that were filled would be lost
_MOSTLY = 0.25  # of a patch
_CELLS = 200.0  # to the image radius, at most: sectors of the ring are looked for as coarsely
_FLOOR = 1e-3  # of the mean light: under it the logarithm says nothing
_LEVELS = 0.12, 0.17, 0.24, 0.34, 0.48, 0.68, 0.96, 1.36  # log light over what is around: outlines are tried at each
_AROUND = 0.7  # radians of azimuth that "around" is
_STEP = 4  # of the grid on which that median is taken
_AREA = 0.005, 0.15  # of the squared radius: what a reflection covers
_LONG, _FULL = 1.5, 0.6  # along the ring over across it, and the share of such a rectangle that is covered
_NEAREST = 0.75  # image radii: no reflection's middle is nearer to the centre
_ACROSS_PX = 3.0  # on both sides of an outline
_CONTRAST = 0.04  # log light
_RISE, _UNEVEN = 0.16, 0.6  # least change across an outline, and its scatter along the outline over its mean
_SUPPORT = 0.75  # of an outline: both pictures change across it, by more than that, to the same side
_SKIRT_PX = 2  # an outline runs where the light is half of the reflection's; its edge is soft


def mask_of_rectangles(shape: tuple[int, int], rectangles_px: Sequence[tuple[int, int, int, int]]) -> Mask:
    """Mask (h, w) of rectangles left, top, width, height; raises ImageError for one that is not in the picture."""
    mask = np.zeros(shape, np.bool_)
    for left, top, width, height in rectangles_px:
        inside = 0 <= left < left + width <= shape[1] and 0 <= top < top + height <= shape[0]
        if not inside:
            raise ImageError(f"rectangle {left},{top},{width},{height} is not within {shape[1]} x {shape[0]} pixels.")
        mask[top : top + height, left : left + width] = True
    return mask


def common_layer(front: Float64, back: Float64) -> Float64:
    """What two log pictures (r, count) on the same ring have in common: a layer whose mean is 0.

    Of their differences between neighbours, both directions, those of equal sign count, the smaller of the two; the
    layer has these differences in the least squares sense (Weiss 2001, whose median of many pictures this is for two).
    """
    parts = []
    for axis in (0, 1):
        one, other = (np.diff(picture, axis=axis, append=np.take(picture, [0], axis)) for picture in (front, back))
        same = np.sign(one) == np.sign(other)
        parts.append(np.where(same, np.sign(one) * np.minimum(np.abs(one), np.abs(other)), 0.0))
    down, around = parts
    down[-1] = 0.0  # the radius does not wrap
    return _integrated(down, around)


def _integrated(down: Float64, around: Float64) -> Float64:
    """Least squares layer of forward differences: periodic along rows, free at the inner and outer rim.

    The normal equations are diagonal in a cosine transform along the radius and a Fourier transform along the azimuth.
    """
    rows, columns = down.shape
    divergence = down - np.roll(down, 1, axis=0) + around - np.roll(around, 1, axis=1)
    transformed = fft(dct(divergence, type=2, axis=0, norm="ortho"), axis=1)
    along_r = 2 - 2 * np.cos(np.pi * np.arange(rows) / rows)
    along_phi = 2 - 2 * np.cos(2 * np.pi * np.arange(columns) / columns)
    eigen = along_r[:, None] + along_phi[None, :]
    eigen[0, 0] = 1.0
    transformed = -transformed / eigen
    transformed[0, 0] = 0.0
    return np.asarray(idct(ifft(transformed, axis=1).real, type=2, axis=0, norm="ortho"), np.float64)


@dataclass(frozen=True, eq=False)
class FrameReflections:
    """Masks (h, w) of the frame's reflections in both pictures, and how many patches they are."""

    front: Mask
    back: Mask
    count: int


def find_reflections(
    front: NDArray[np.floating], back: NDArray[np.floating], circles: tuple[ImageCircle, ImageCircle]
) -> FrameReflections:
    """Reflections of the lens's frame in linear pictures (h, w, 3) of two different directions by one lens.

    They sit at the same place of the image circle while the scene differs, and follow the frame's ring. Outlines are
    drawn, at several levels, in the layer that the luminance of both pictures has in common; those count across which
    both change alike, of the size and shape that a frame leaves. Beside them count sectors of the ring across whose
    sides both pictures step, in light or in colour, either way. Soft sectors are then fitted to both pictures. One that
    has the light and the colour of both scenes is not found: give it as a mask.
    """
    lights = [np.nan_to_num(np.asarray(picture, np.float64)) for picture in (front, back)]
    shape = lights[0].shape[:2]
    grid = ring_grid(circles[0])
    logs = [_ring_log(light.mean(axis=-1), grid.of(circle)) for light, circle in zip(lights, circles, strict=True)]
    ring = _patches(_Layers.of(*logs), grid)
    coarse = ring_grid(circles[0], max(circles[0].radius_px / _CELLS, 1.0))
    features = [_colour_logs(light, coarse.of(circle)) for light, circle in zip(lights, circles, strict=True)]
    outlined = coarse.sample(grid.back(ring.astype(np.float64), shape)) > 0.5
    fitted = np.stack([_channels(light, coarse.of(circle)) for light, circle in zip(lights, circles, strict=True)])
    covered = sectors_and_outlines(fitted, sectors_of_ring(features, coarse), outlined, coarse).astype(np.float64)
    masks = [coarse.of(circle).back(covered, shape) > 0.5 for circle in circles]
    lamps = [light.mean(axis=-1) > _LAMP * light.mean() for light in lights]
    masks = [_without(mask, grid.of(circle), lamps, circles) for mask, circle in zip(masks, circles, strict=True)]
    return FrameReflections(masks[0], masks[1], int(label(masks[0])[1]))


def _without(mask: Mask, grid: RingGrid, lamps: Sequence[Mask], circles: Sequence[ImageCircle]) -> Mask:
    """The mask without lamps that either picture shows at the same place of the ring, and patches that are mostly such.

    A patch that only touches a lamp stays, but for the lamp.
    """
    shown = [grid.of(circle).sample(lamp.astype(np.float64)) for lamp, circle in zip(lamps, circles, strict=True)]
    lamp = binary_dilation(grid.back(np.maximum(*shown), mask.shape) > 0, iterations=_SKIRT_PX)
    numbers, count = label(mask)
    share = np.atleast_1d(mean(lamp, numbers, np.arange(count + 1)))
    return np.asarray(mask & ~lamp & (share[numbers] < _MOSTLY), np.bool_)


def _channels(light: Float64, grid: RingGrid) -> Float64:
    """Light (3, r, count) in means of the picture."""
    mean_light = max(float(light.mean()), np.finfo(float).tiny)
    return np.stack([grid.sample(np.minimum(channel / mean_light, _LAMP)) for channel in np.moveaxis(light, -1, 0)])


def _colour_logs(light: Float64, grid: RingGrid) -> Float64:
    """Logarithms (3, r, count) of luminance, and of red and blue over green."""
    floor = max(_FLOOR * float(light.mean()), np.finfo(float).tiny)
    channels = [light.mean(axis=-1), *np.moveaxis(light, -1, 0)]
    blur = _BLUR_PX * grid.step_px
    log, red, green, blue = (
        grid.sample(np.log(np.maximum(gaussian_filter(channel, blur), floor))) for channel in channels
    )
    return np.stack([log, red - green, blue - green])


def _ring_log(picture: NDArray[np.floating], grid: RingGrid) -> Float64:
    light = np.nan_to_num(np.asarray(picture, np.float64))
    floor = max(_FLOOR * float(light.mean()), np.finfo(float).tiny)
    return grid.sample(np.log(np.maximum(gaussian_filter(light, _BLUR_PX), floor)))


def _surroundings(layer: Float64) -> Float64:
    """Median (count,) over the ring's whole height and a part of its azimuths, found at every few places."""
    coarse = layer[::_STEP, ::_STEP]
    half = max(int(_AROUND / (4 * np.pi) * coarse.shape[1]), 1)
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(coarse, ((0, 0), (half, half)), "wrap"), 2 * half + 1, 1)
    medians = np.median(windows, axis=(0, 2))
    places = np.arange(layer.shape[1]) / _STEP
    return np.asarray(np.interp(places, np.arange(len(medians) + 1), np.append(medians, medians[0])))


@dataclass(frozen=True, eq=False)
class _Layers:
    """Two log pictures on a ring, what they have in common, and that over its surroundings; all (r, count)."""

    logs: tuple[Float64, Float64]
    common: Float64
    raised: Float64

    @classmethod
    def of(cls, one: Float64, other: Float64) -> "_Layers":
        common = common_layer(one, other)
        return cls((one, other), common, common - _surroundings(common))

    def turned(self, by: int) -> "_Layers":
        one, other, common, raised = (np.roll(part, by, axis=1) for part in (*self.logs, self.common, self.raised))
        return _Layers((one, other), common, raised)


@dataclass(frozen=True, eq=False)
class _Outline:
    """A `patch` within the `box` of a ring, how much the log light `rises` in it, and how well that is borne out."""

    box: tuple[slice, slice]
    patch: Mask
    rises: float
    score: float


def _patches(layers: _Layers, grid: RingGrid) -> Mask:
    """The outlines that the pictures bear out, the steepest first, where they do not touch one another."""
    found = []
    for turn in (0, grid.count // 2):  # a patch that lies across azimuth 0 is whole in one of two turns
        for outline in _outlines(layers.turned(turn), grid):
            whole = np.zeros(layers.common.shape, np.bool_)
            whole[outline.box] = outline.patch
            found.append((outline, np.roll(whole, -turn, axis=1)))
    mask = np.zeros(layers.common.shape, np.bool_)
    for outline, patch in sorted(found, key=lambda one: -one[0].score):
        if not (mask & patch).any():
            # The middle of a step of log light lies outside of a bright patch's edge, the more as light is blurred
            # before its logarithm is taken, and inside of a dark one's.
            by = 0.9 if outline.rises > 0 else 0.5
            skirt = round(float(np.clip(_SKIRT_PX - by * outline.rises, 0, 2 * _SKIRT_PX)))
            mask |= binary_dilation(patch, iterations=skirt) if skirt else patch
    return mask


def _outlines(layers: _Layers, grid: RingGrid) -> list[_Outline]:
    """Every outline of a fitting size and shape that enough of both pictures bears out."""
    found = []
    for sign in (1.0, -1.0):
        for level in _LEVELS:
            numbers, _ = label(sign * layers.raised > level)
            for number, place in enumerate(find_objects(numbers), start=1):
                if not _fits(numbers[place] == number, place[0], grid):
                    continue
                box = _widened(place[0], numbers.shape[0]), _widened(place[1], numbers.shape[1])
                patch = numbers[box] == number
                pictures = [picture[box] for picture in (layers.common, *layers.logs)]
                rise, support = _rise(patch, pictures, sign)
                if support >= _SUPPORT:
                    found.append(_Outline(box, patch, sign * rise, support * rise))
    return found


def _fits(patch: Mask, rows: slice, grid: RingGrid) -> bool:
    """Whether a patch, cut out, has the size, place and shape of a frame's reflection."""
    outer = grid.outer_px
    area, (high, wide) = np.count_nonzero(patch), patch.shape
    if rows.start == 0 or rows.stop == len(grid.radii_px) or not _AREA[0] * outer**2 < area < _AREA[1] * outer**2:
        return False
    middle = grid.radii_px[rows.start] + (patch.sum(axis=1) @ np.arange(high)) / area
    return bool(wide >= _LONG * high and area >= _FULL * high * wide and middle >= _NEAREST * outer)


def _widened(part: slice, size: int) -> slice:
    margin = int(2 * _ACROSS_PX)
    return slice(max(part.start - margin, 0), min(part.stop + margin, size))


def _rise(patch: Mask, pictures: list[Float64], sign: float) -> tuple[float, float]:
    """By how much the layer rises across an outline, and the share of it that is borne out; 0 where that is uneven."""
    outline = patch & ~binary_erosion(patch, border_value=True)
    signed = gaussian_filter(distance_transform_edt(patch) - distance_transform_edt(~patch), 1.5)
    toward = np.stack(np.gradient(signed), axis=-1)[outline]
    toward /= np.maximum(np.linalg.norm(toward, axis=-1, keepdims=True), 1e-6)
    places = np.argwhere(outline)
    inner, outer = (places + way * _ACROSS_PX * toward for way in (1, -1))
    layer, one, other = (
        sign * (map_coordinates(picture, inner.T, order=1, mode="nearest")
                - map_coordinates(picture, outer.T, order=1, mode="nearest"))
        for picture in pictures
    )  # fmt: skip
    smaller, rise = np.minimum(one, other), float(layer.mean())
    if rise < _RISE or layer.std() > _UNEVEN * rise or np.median(smaller) < _RISE:
        return rise, 0.0
    return rise, float((smaller > _CONTRAST).mean())
