"""The two bracketed photographs of a place, each merged to linear light, on one scale."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.formats.photo import Photograph, read_photo
from processing.products.arrays import Float32
from processing.radiometry import photograph_kernel
from processing.radiometry.alignment import shift_error
from processing.radiometry.bracket import RAW_SUFFIXES, merge_files, photograph_exposures
from processing.radiometry.hdr import PixelStatus, Radiance
from processing.radiometry.photograph_shift import photograph_shift
from processing.radiometry.photographs import merge_photographs, merge_tables
from processing.radiometry.response import Response

_WHITE = 255  # code
_MIDDLE, _WELL = (40, 235), 0.05  # codes that are well exposed, and the least share of them in a photograph


@dataclass(frozen=True)
class Bracket:
    """Files of one bracketed photograph; `exposure_s`, in the same order, where the files do not state their own."""

    files: tuple[Path, ...]
    exposure_s: tuple[float, ...] | None = None


@dataclass(frozen=True, eq=False)
class ProbePhotograph:
    """Linear `picture` (h, w, 3) in sRGB primaries: at least what is told where `clipped` (h, w), NaN where unknown.

    `absolute` where radiance compares with that of another bracket of the camera. `response` is that of JPEG files.
    """

    picture: Float32
    clipped: NDArray[np.bool_]
    absolute: bool
    response: Response | None

    @property
    def luminance(self) -> Float32:
        """Mean of the channels (h, w)."""
        return np.asarray(self.picture.mean(axis=-1), np.float32)

    def halved(self) -> "ProbePhotograph":
        """Half as many rows and columns, means of what is known; clipped where any of four pixels is."""
        blocks = _blocks(self.picture)
        known = np.isfinite(blocks)
        count = known.sum(axis=(1, 3))
        sums = np.where(known, blocks, 0.0).sum(axis=(1, 3))
        mean = np.divide(sums, count, out=np.full(sums.shape, np.nan), where=count > 0)
        return replace(self, picture=np.asarray(mean, np.float32), clipped=halved_mask(self.clipped))


def halved_mask(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A mask (h, w) at half as many rows and columns: set where any of four pixels is."""
    return np.asarray(_blocks(mask).any(axis=(1, 3)), np.bool_)


def _blocks(picture: NDArray[Any]) -> NDArray[Any]:
    """Squares of four pixels (h // 2, 2, w // 2, 2, ...); an odd last row or column is left out."""
    height, width = (side // 2 for side in picture.shape[:2])
    return picture[: 2 * height, : 2 * width].reshape(height, 2, width, 2, *picture.shape[2:])


def merge_brackets(front: Bracket, back: Bracket) -> tuple[ProbePhotograph, ProbePhotograph]:
    """Both photographs by one response: the front's, or the back's where the front shows too few shades to tell.

    Raises ImageError as `merge_bracket` does, where neither bracket determines the response, or the sizes differ.
    """
    try:
        first = merge_bracket(front)
    except ImageError as error:
        try:
            second = merge_bracket(back)
        except ImageError:
            raise error from None
        first = merge_bracket(front, second.response)
    else:
        second = merge_bracket(back, first.response)
    if first.picture.shape != second.picture.shape:
        raise ImageError(
            f"front of {first.picture.shape[:2]} pixels, back of {second.picture.shape[:2]}: not one lens."
        )
    return first, second


def merge_bracket(bracket: Bracket, response: Response | None = None) -> ProbePhotograph:
    """One bracket to linear light; clipped pixels have the most that the shortest exposure measures.

    Without a `response` that of photographs is recovered from them.
    Raises ImageError as `merge_files` does: no exposure times in the files and none given, a camera that moved, files
    of different cameras, no response.
    """
    if bracket.files and all(path.suffix.lower() in RAW_SUFFIXES for path in bracket.files):
        merged = merge_files(bracket.files)
        return _bounded(merged.radiance, merged.srgb_from_camera, None, 0.0)
    frames = {path: read_photo(path) for path in bracket.files}
    stated = _exposures(bracket, frames)
    order = sorted(frames, key=lambda path: stated[path])
    names = [str(path) for path in order]
    if len({frame.srgb8.shape for frame in frames.values()}) != 1 or len(bracket.files) != len(frames):
        raise ImageError(f"{', '.join(names)}: photographs of one size, each named once, are needed.")
    stack = np.stack([frames[path].srgb8 for path in order])
    exposure = np.array([stated[path] for path in order])
    well = _well_exposed(stack)
    found = merge_photographs(stack[well], exposure[well], response, [names[i] for i in well])
    exposure[well] = found.exposure
    for i in range(len(stack) - 1):
        shift = photograph_shift(stack[i : i + 2], found.response, (i, i + 1))
        if shift.refused:
            raise shift_error(shift, names)
    tables = merge_tables(found.response)
    radiance = Radiance(*photograph_kernel.merge_photographs(stack, np.log(exposure), *tables))
    camera = replace(found.response, camera=frames[order[0]].model)
    absolute = all(frame.iso > 0 and frame.f_number > 0 for frame in frames.values())
    photograph = _bounded(radiance, np.eye(3), camera, float(exposure[0]))
    return replace(photograph, absolute=absolute or bracket.exposure_s is not None)


def _well_exposed(stack: NDArray[np.uint8]) -> NDArray[np.intp]:
    """Photographs that tell the response and check their exposures; all, where fewer than two do.

    One that shows little but a lamp has its few middle codes at edges, where JPEG mixes them: it would be judged by
    those. Its exposure is taken as stated.
    """
    share = np.mean((stack >= _MIDDLE[0]) & (stack <= _MIDDLE[1]), axis=(1, 2, 3))
    well = np.flatnonzero(share > _WELL)
    return well if len(well) > 1 else np.arange(len(stack))


def _exposures(bracket: Bracket, frames: Mapping[Path, Photograph]) -> Mapping[Path, float]:
    if bracket.exposure_s is None:
        return photograph_exposures(frames)
    if len(bracket.files) != len(bracket.exposure_s):
        raise ImageError(f"{len(bracket.files)} photographs with {len(bracket.exposure_s)} exposure times.")
    return dict(zip(bracket.files, bracket.exposure_s, strict=True))


def _bounded(
    radiance: Radiance, srgb_from_camera: NDArray[np.float64], response: Response | None, shortest: float
) -> ProbePhotograph:
    clipped = radiance.status == PixelStatus.SATURATED
    most = np.where(np.isfinite(radiance.value), radiance.value, 0.0).max(axis=(0, 1))
    if response is not None:
        most = np.maximum(most, response.light[_WHITE] / shortest)
    picture = np.maximum(np.where(clipped, most, radiance.value) @ srgb_from_camera.T, 0.0)
    return ProbePhotograph(np.asarray(picture, np.float32), clipped.any(axis=-1), True, response)
