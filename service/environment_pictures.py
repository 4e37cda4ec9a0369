"""Environments as pictures: the panorama, and what was found in the photographs that it was made of."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure  # not pyplot, whose figures all threads share
from matplotlib.patches import Circle
from numpy.typing import NDArray

from processing.environment.brackets import ProbePhotograph
from processing.environment.capture import CapturedEnvironment
from processing.environment.equirectangular import panorama_of
from processing.environment.fisheye_pair import FisheyeView
from processing.environment.image_circle import ImageCircle
from processing.products import Environment
from processing.products.arrays import Float64
from processing.radiometry.display import tonemap
from render.picture import save_image

_SIDE_PX = 700  # of a photograph's shorter side in the picture, about
_LEAST_PX = 256  # of a panorama's height
_CIRCLE, _MASK, _CLIPPED, _SEAM = "cyan", "red", "magenta", "yellow"


def draw_environment(product: Path, out: Path) -> None:
    """An environment all around, tone-mapped: +X in the middle, +Y to the left, +Z above."""
    save_image(out, panorama_picture(Environment.load(product)))


def panorama_picture(environment: Environment) -> NDArray[np.uint8]:
    """Codes (h, 2 h, 3) of an equirectangular picture as fine as the cubemap, not smaller than a person can look at."""
    return tonemap(panorama_of(environment, max(2 * environment.size, _LEAST_PX)).picture)


def save_found(path: Path, photographs: tuple[ProbePhotograph, ProbePhotograph], captured: CapturedEnvironment) -> None:
    """Front and back with image circle, reflections of the frame, clipped light, and the seam between them."""
    figure = Figure(figsize=(13, 6), layout="constrained")
    axes = figure.subplots(1, 2)
    turn, masks = captured.registration.front_from_back, (captured.reflections.front, captured.reflections.back)
    for i, (axis, name) in enumerate(zip(axes, ("front", "back"), strict=True)):
        _draw_photograph(axis, photographs[i], captured.circles[i])
        _draw_outlines(axis, masks[i], _MASK)
        _draw_outlines(axis, photographs[i].clipped, _CLIPPED)
        height, width = masks[i].shape
        columns, rows, nearer = _nearer(photographs[i], captured, (turn, turn.T)[i])
        axis.contour(columns, rows, nearer, levels=[0.0], colors=_SEAM, linewidths=0.8)
        axis.set(title=name, xticks=[], yticks=[], xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
    figure.suptitle(
        f"{_CIRCLE}: image circle, {_MASK}: reflections of the frame, {_CLIPPED}: clipped, {_SEAM}: seam", fontsize=10
    )
    figure.savefig(path, dpi=110)


def _draw_photograph(axis: Axes, photograph: ProbePhotograph, circle: ImageCircle) -> None:
    """The border is left black: it would make the place too bright."""
    step = _step(photograph.luminance)
    rows, columns = np.indices(photograph.luminance.shape)[:, ::step, ::step]
    across, down = circle.centre_px
    inside = np.hypot(columns - across, rows - down) <= circle.radius_px
    shown = np.where(inside[..., None], photograph.picture[::step, ::step], np.nan)
    height, width = photograph.luminance.shape
    axis.imshow(tonemap(shown), extent=(-0.5, width - 0.5, height - 0.5, -0.5))
    rim = Circle((float(across), float(down)), circle.radius_px, fill=False, edgecolor=_CIRCLE, linewidth=0.8)
    axis.add_patch(rim)


def _draw_outlines(axis: Axes, mask: NDArray[np.bool_], colour: str) -> None:
    step, (height, width) = _step(mask), mask.shape
    shown = mask[::step, ::step].astype(np.float64)
    if shown.any():
        axis.contour(
            np.arange(0, width, step), np.arange(0, height, step), shown, levels=[0.5], colors=colour, linewidths=0.8
        )


def _nearer(
    photograph: ProbePhotograph, captured: CapturedEnvironment, own_from_other: Float64
) -> tuple[Float64, Float64, Float64]:
    """Columns, rows, and by how much what a pixel sees is nearer to its own axis than to the other's; NaN outside."""
    step = _step(photograph.luminance)
    lens = captured.registration.lens
    view = FisheyeView(photograph.picture, lens, lens.reach_rad, np.eye(3), np.isfinite(photograph.luminance))
    shape = photograph.luminance.shape
    away = np.arccos(np.clip(view.directions @ own_from_other[:, 2], -1.0, 1.0)).reshape(shape)
    inside = view.polar_rad <= np.radians(captured.environment.provenance.parameters["field_deg"]) / 2
    nearer = np.where(inside, away - view.polar_rad, np.nan)[::step, ::step]
    return np.arange(0.0, shape[1], step), np.arange(0.0, shape[0], step), np.asarray(nearer, np.float64)


def _step(picture: NDArray[Any]) -> int:
    return max(1, min(map(int, picture.shape[:2])) // _SIDE_PX)
