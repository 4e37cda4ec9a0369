"""`rig environment`: the light of a place, of photographs or panoramas from anywhere."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from processing import geometry
from processing.environment.brackets import Bracket, halved_mask, merge_brackets
from processing.environment.capture import CapturedEnvironment, CaptureOptions, environment_of
from processing.environment.equirectangular import read_environment, write_panorama
from processing.environment.image_circle import equidistant, find_circle
from processing.environment.reflections import mask_of_rectangles
from processing.environment.registration import HALF_TURN
from processing.errors import ImageError
from processing.formats.sequence import read_picture
from processing.products import Environment
from processing.products.arrays import Float64
from render.picture import save_image
from service.environment_files import brackets_of, halved_lens, panorama_among, read_lens
from service.environment_pictures import panorama_picture, save_found
from service.files import check_folder, filled, replaced

FOUND, PICTURE = "found.png", "environment.png"
Rectangle = tuple[int, int, int, int]  # left, top, width, height
_FINER = 4.0  # a photograph with more pixels to a texel, along a side, is averaged first
_STRONG, _NARROW = 1e3, 0.1  # times the mean, and the share of the light in one texel, that are told as a doubt


@dataclass(frozen=True)
class PlaceOptions:
    """As a person gives them: degrees, names of files, rectangles LEFT,TOP,WIDTH,HEIGHT.

    `turn` is by how much the back camera is off half a turn about its vertical, X,Y,Z in degrees about the front
    camera's axes (right, down, ahead); empty where it is to be found. `lens` is a calibrated one. `azimuth_deg` is
    where the front camera, or a panorama's middle, looks, from +X toward +Y.
    """

    field_deg: float = 190.0
    size: int = 128
    azimuth_deg: float = 0.0
    mask: Path | None = None
    hide: tuple[str, ...] = ()
    detect: bool = True
    turn: str = ""
    lens: Path | None = None


def make_environment(
    sources: list[Path], out: Path, options: PlaceOptions, panorama: Path | None = None
) -> Iterator[str]:
    """Make the product `environment` in the folder `out`, pictures of it beside; tells what was found.

    `panorama` (.exr or .hdr) gets the same light as an equirectangular picture. Raises ImageError where something is
    missing, mixed or damaged, or photographs do not fit together; then nothing is written.
    """
    for target in (out, *([] if panorama is None else [panorama])):
        check_folder(target)
    if panorama is not None and panorama.suffix.lower() not in (".exr", ".hdr"):
        raise ImageError(f"{panorama}: an environment is written as .exr or .hdr")
    imported = panorama_among(sources)
    with filled(out) as part:
        if imported is None:
            front, back = brackets_of(sources)
            yield f"front: {_names(front)}; back: {_names(back)}"
            captured, told = photographed(front, back, options, part)
            environment = captured.environment
            yield from told
        else:
            environment, repaired = read_environment(
                imported, options.size, azimuth_rad=float(np.radians(options.azimuth_deg))
            )
            yield from _about_repairs(repaired)
        yield from about_light(environment)
        environment.save(part)
        save_image(part / PICTURE, panorama_picture(environment))
    if panorama is not None:
        with replaced(panorama) as part:
            write_panorama(part, environment, 2 * options.size)
        yield f"{panorama}: equirectangular, {4 * options.size} x {2 * options.size} pixels"
    yield f"{out}: cubemap of 6 faces of {options.size} pixels; `rig preview MATERIAL --environment {out}` lights by it"


def photographed(
    front: Bracket, back: Bracket, options: PlaceOptions, out: Path
) -> tuple[CapturedEnvironment, list[str]]:
    """The light of two bracketed photographs, a picture of what was found in the folder `out`, and it in words.

    Raises ImageError as `capture_environment` does.
    """
    turn = _turn(options.turn) if options.turn else None
    hidden_px = [_rectangle(text) for text in options.hide]
    lens = None if options.lens is None else read_lens(options.lens)
    photographs = merge_brackets(front, back)
    height, width = photographs[0].luminance.shape
    mask, coarser = _mask(options.mask, hidden_px, (height, width)), 1
    by_circle = equidistant(find_circle(photographs[0].luminance), float(np.radians(options.field_deg)))
    focal_px = (lens or by_circle).matrix[0, 0]
    while focal_px / (2 * coarser) * 2 / options.size > _FINER:
        photographs = photographs[0].halved(), photographs[1].halved()
        mask, coarser = None if mask is None else halved_mask(mask), 2 * coarser
        lens = None if lens is None else halved_lens(lens)
    capture = CaptureOptions(
        field_rad=float(np.radians(options.field_deg)),
        size=options.size,
        lens=lens,
        mask=mask,
        detect=options.detect,
        front_from_back=turn,
        world_from_front=_ahead(options.azimuth_deg),
    )
    names = tuple(path.name for bracket in (front, back) for path in bracket.files)
    captured = environment_of(photographs, capture, names)
    save_found(out / FOUND, photographs, captured)
    return captured, list(_about_photographs(captured, coarser))


def _mask(path: Path | None, hidden_px: list[Rectangle], shape: tuple[int, int]) -> NDArray[np.bool_] | None:
    """What a person marked, None where nothing was."""
    if path is None and not hidden_px:
        return None
    mask = mask_of_rectangles(shape, hidden_px)
    if path is not None:
        picture = read_picture(path)
        marked = np.asarray(picture.any(axis=-1) if picture.ndim == 3 else picture > 0, np.bool_)
        if marked.shape != shape:
            told = f"{marked.shape[1]} x {marked.shape[0]} pixels; the photographs have {shape[1]} x {shape[0]}"
            raise ImageError(f"{path}: {told}.")
        mask |= marked
    return mask


def _rectangle(text: str) -> Rectangle:
    try:
        left, top, width, height = (int(edge) for edge in text.split(","))
    except ValueError as error:
        raise ImageError(f"rectangle {text!r}: four numbers are needed, LEFT,TOP,WIDTH,HEIGHT in pixels.") from error
    return left, top, width, height


def _turn(text: str) -> Float64:
    try:
        right, down, ahead = (float(angle) for angle in text.split(","))
    except ValueError as error:
        raise ImageError(f"turn {text!r}: three angles are needed, X,Y,Z in degrees; 0,0,0 is half a turn.") from error
    off = geometry.rigid_from_vectors(np.radians([right, down, ahead]), np.zeros(3))[:3, :3]
    return np.asarray(off @ HALF_TURN, np.float64)


def _ahead(azimuth_deg: float) -> Float64:
    azimuth = np.radians(azimuth_deg)
    return geometry.look_at(np.zeros(3), (np.cos(azimuth), np.sin(azimuth), 0.0))[:3, :3]


def _names(bracket: Bracket) -> str:
    return f"{bracket.files[0].name} ... {bracket.files[-1].name} ({len(bracket.files)})"


def _about_photographs(captured: CapturedEnvironment, coarser: int) -> Iterator[str]:
    circle, found = captured.circles[0], captured.registration
    column, row = coarser * (circle.centre_px + 0.5) - 0.5
    yield f"image circle of {coarser * circle.radius_px:.1f} px radius around {column:.1f}, {row:.1f}"
    count = captured.reflections.count
    yield f"reflections of the frame: {count} found; {_hidden(captured):.2%} of the circle is filled anew"
    off = np.degrees(np.arccos(np.clip((np.trace(found.front_from_back @ HALF_TURN.T) - 1) / 2, -1, 1)))
    if np.isfinite(found.sigma_rad) and found.overlap > 0:
        yield (
            f"the back is {off:.2f} deg off half a turn (+- {np.degrees(found.sigma_rad):.2f} deg), light at the seam "
            f"correlates by {found.likeness:.2f}"
        )
    if captured.clipped > 0:
        yield (
            f"WARNING: {captured.clipped:.3%} of the sphere is brighter than the shortest exposure measures: there is "
            "more light than told. Add shorter exposures."
        )
    if captured.uncovered > 0:
        yield f"WARNING: {captured.uncovered:.2%} of the sphere is in neither photograph and made up from beside it"


def _hidden(captured: CapturedEnvironment) -> float:
    masks = captured.reflections.front, captured.reflections.back
    return float(sum(mask.sum() for mask in masks) / (2 * np.pi * captured.circles[0].radius_px ** 2))


def _about_repairs(repaired: int) -> Iterator[str]:
    if repaired:
        yield f"WARNING: {repaired} values were no numbers or infinite; filled from around, or the largest there is"


def about_light(environment: Environment) -> Iterator[str]:
    """How much light, and of what a sun takes of it; raises ImageError where there is none."""
    luminance = environment.radiance.astype(np.float64).mean(axis=-1)
    weighted = luminance * environment.solid_angles
    if not weighted.sum() > 0:
        raise ImageError("the environment is black all around.")
    mean, share = weighted.sum() / (4 * np.pi), weighted.max() / weighted.sum()
    x, y, z = environment.directions.reshape(-1, 3)[weighted.argmax()]
    where = f"azimuth {np.degrees(np.arctan2(y, x)):.0f} deg, elevation {np.degrees(np.arcsin(z)):.0f} deg"
    yield f"mean radiance {mean:.4g}; the brightest texel has {luminance.max() / mean:.4g} times that ({where})"
    if luminance.max() > _STRONG * mean or share > _NARROW:
        yield (
            f"WARNING: one texel holds {share:.0%} of the light, as a sun does: it is spread over "
            f"{np.degrees(2 / environment.size):.2g} deg, and so are shadows' edges; a larger --size makes them sharper"
        )
