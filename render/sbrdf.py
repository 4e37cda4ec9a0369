"""SBRDF+ on the graphics card: lobes, shadows, shifts and clusters; its shader is shaders/sbrdf.frag."""

from collections.abc import Sequence

import moderngl
import numpy as np

from processing.products import LafortuneTexels, SbrdfPlus
from render.arrays import Float32, Float64, Int32, Rows
from render.programs import Binding, Value
from render.textures import direction_tables, table, texture_array

SHADER = "sbrdf.frag"
# A level is chosen by the shorter side of what a pixel covers, unless the longer one is more than so many times longer.
ANISOTROPY = 2.0
# As in the shader: what tells a hidden point, and bits of each of the two numbers of a shift.
_HIDDEN, _BITS = 1 << 31, 15


def upload(context: moderngl.Context, sbrdf: SbrdfPlus) -> Binding:
    """Shifts and shadows of four neighbours in one texel, lobes a texel each, and the centres; levels side by side."""
    levels = (sbrdf, *sbrdf.coarser)
    areas = _areas(levels)
    units = [_units_per_texel(level) for level in levels]
    first = np.cumsum([0, *(len(level.centres) for level in levels)])
    present = max(_present(level.lobes) for level in levels)
    codes = [_shift_codes(level, unit, row) for level, unit, row in zip(levels, units, first[:-1], strict=True)]
    layers = {
        "shift": _atlas([_neighbours(code) for code in codes], areas),
        "shadow": _atlas([_neighbours(level.shadow.astype(np.float32)) for level in levels], areas),
        "lobes": _atlas([_lobe_layers(level.lobes, present) for level in levels], areas),
    }
    textures: dict[str, moderngl.Texture | moderngl.TextureArray] = {
        name: texture_array(context, values, f"{name} of the SBRDF+", wrap=False) for name, values in layers.items()
    }
    textures["centres"] = table(context, _centres(levels))
    for name, mesh in (("light", sbrdf.lights), ("view", sbrdf.views)):
        textures |= direction_tables(context, name, mesh)
    blended = [f"LEVELS {len(levels)}"] if len(levels) > 1 else []
    values: dict[str, Value] = {
        "areas": areas.astype(np.float32),
        "shift_units": (1.0 / np.array(units)).astype(np.float32),
        "lowest": (sbrdf.lights.lowest, sbrdf.views.lowest),
    }
    return Binding(SHADER, textures, values, frozenset([f"LOBES {present}", *blended]))


def outgoing(sbrdf: SbrdfPlus, uv: Rows, light: Rows, view: Rows, footprint: Rows | None = None) -> Float64:
    """Radiance (n, 3) for unit irradiance on a surface that faces the light, in NumPy.

    `footprint` (n, 2, 2), how texture coordinates change to the next pixel right and below, chooses two levels of the
    product to be blended; left out, the finest is asked.
    """
    if footprint is None or not sbrdf.coarser:
        return sbrdf.evaluate(uv, light, view)
    levels = (sbrdf, *sbrdf.coarser)
    level = np.clip(np.log2(side_texels(footprint, sbrdf.lobes.shape)), 0.0, len(levels) - 1.0)
    radiance = np.zeros((len(uv), 3))
    for number, product in enumerate(levels):
        weight = np.maximum(1.0 - np.abs(level - number), 0.0)
        near = weight > 0.0
        if near.any():
            radiance[near] += weight[near, None] * product.evaluate(uv[near], light[near], view[near])
    return radiance


def side_texels(footprint: Rows, shape: tuple[int, int]) -> Float64:
    """Side (n,) in texels of what a pixel covers: its shorter axis, or the longer one over ANISOTROPY, at least 1.

    The axes are the singular values of the derivatives (n, 2, 2) of texture coordinates over pixels.
    """
    across, down = np.moveaxis(np.asarray(footprint, np.float64) * np.array(shape[::-1]), 1, 0)
    total = ((across * across).sum(axis=1) + (down * down).sum(axis=1)) / 2
    area = across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0]
    longer = np.sqrt(total + np.sqrt(np.maximum(total * total - area * area, 0.0)))
    return np.asarray(np.maximum(np.maximum(np.abs(area) / np.maximum(longer, 1e-30), longer / ANISOTROPY), 1.0))


def _areas(levels: Sequence[SbrdfPlus]) -> Int32:
    """Left, top, width and height of each level: the finest left, all others right of it under each other.

    A column right of each and a row below it repeat its first ones, so that no tap has to turn back.
    """
    height, width = levels[0].lobes.shape
    areas, top = [(0, 0, width, height)], 0
    for level in levels[1:]:
        rows, columns = level.lobes.shape
        areas.append((width + 1, top, columns, rows))
        top += rows + 1
    return np.array(areas, np.int32)


def _atlas(levels: Sequence[Rows], areas: Int32) -> Rows:
    """Layers (n, y, x, 4) that hold those of all levels in their areas."""
    columns, rows = (areas[:, :2] + areas[:, 2:] + 1).max(axis=0)
    atlas = np.zeros((len(levels[0]), rows, columns, 4), levels[0].dtype)
    for layers, (left, top, width, height) in zip(levels, areas, strict=True):
        bordered = np.pad(layers, ((0, 0), (0, 1), (0, 1), (0, 0)), mode="wrap")
        atlas[:, top : top + height + 1, left : left + width + 1] = bordered
    return atlas


def _centres(levels: Sequence[SbrdfPlus]) -> Float32:
    """Those of all levels under each other; one that is nobody's where there are none."""
    centres = np.concatenate([level.centres for level in levels])
    return centres if len(centres) else np.zeros((1, len(levels[0].lights.directions), 3), np.float32)


def _units_per_texel(sbrdf: SbrdfPlus) -> Float64:
    """Units of the shift right and down: as many as fit for the longest one.

    They are a multiple of the steps of a packed product, whose shifts so stay exact: 256 along a tile or a little less.
    """
    longest = float(np.abs(np.where(sbrdf.hidden[..., None], 0.0, sbrdf.shift)).max(initial=0.0))
    steps = np.maximum(256 // np.array(sbrdf.lobes.shape[::-1]), 1)
    return np.asarray(np.maximum((1 << _BITS - 1) / (longest + 1.0) // steps, 1.0) * steps)


def _shift_codes(sbrdf: SbrdfPlus, per_texel: Float64, first_centre: int) -> Rows:
    """Words (view, y, x): the shift right and down in units, or where the centre of a hidden point is."""
    shift = np.where(sbrdf.hidden[..., None], 0.0, sbrdf.shift)
    right, down = np.moveaxis(np.rint(shift * per_texel).astype(np.int64) + (1 << _BITS - 1), 3, 0)
    centre = _HIDDEN + first_centre + sbrdf.cluster.astype(np.int64)
    return np.where(sbrdf.hidden, centre, right << _BITS | down).astype(np.uint32)


def _neighbours(layers: Rows) -> Rows:
    """Layers (n, y, x) with each texel's right, lower and right lower neighbour beside it, (n, y, x, 4)."""
    right = np.roll(layers, -1, axis=2)
    return np.stack([layers, right, np.roll(layers, -1, axis=1), np.roll(right, -1, axis=1)], axis=3)


def _lobe_layers(lobes: LafortuneTexels, present: int) -> Float32:
    """Layers (n, y, x, 4): axis and exponent of each lobe, then the colours of all, the diffuse one last."""
    order = np.argsort(~_is_there(lobes), axis=2, kind="stable")[:, :, :present, None]
    exponent = np.take_along_axis(lobes.exponent[..., None], order, axis=2)
    shapes = np.concatenate([np.take_along_axis(lobes.axis, order, axis=2), exponent], axis=3)
    colours = np.concatenate([np.take_along_axis(lobes.albedo, order, axis=2), lobes.diffuse[:, :, None]], axis=2)
    numbers = colours.reshape(*lobes.shape, -1)
    padded = np.concatenate([numbers, np.zeros((*lobes.shape, -numbers.shape[2] % 4), np.float32)], axis=2)
    layers = np.concatenate([np.moveaxis(shapes, 2, 0), np.moveaxis(padded.reshape(*lobes.shape, -1, 4), 2, 0)])
    return layers.astype(np.float32)


def _present(lobes: LafortuneTexels) -> int:
    """The most lobes that any texel has."""
    return int(_is_there(lobes).sum(axis=2).max(initial=0))


def _is_there(lobes: LafortuneTexels) -> Rows:
    """Which lobes reflect anything, (y, x, lobe)."""
    return np.asarray((lobes.albedo != 0.0).any(axis=3))
