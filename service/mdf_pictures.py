"""The picture of one view of an MDF: the surface, how well it is known, and how the laser's locations agree."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure  # not pyplot, whose figures all threads share
from numpy.typing import NDArray

from processing.laser.displacement import Merged
from processing.products import Mdf

_SUN = np.array([-0.5, 0.5, 0.7]) / np.linalg.norm([-0.5, 0.5, 0.7])  # from the upper left
_NICE_MM = (1, 2, 5, 10, 20, 50, 100, 200, 500)


def draw_view(path: Path, mdf: Mdf, number: int, merged: Merged, told: Mapping[str, Any]) -> None:
    """One view: depths in colours, shaded relief, standard deviation; laser locations per pixel, and how they agree.

    `told` has "view" and "sweeps", each with laser_azimuth_deg, laser_elevation_deg, status, completeness, consistency.
    """
    figure = Figure(figsize=(13, 8.6), layout="constrained")
    depth, relief, deviation, agreed, rejected, sweeps = figure.subplots(2, 3).flat
    displacement_m = mdf.displacement_m[number]
    _show(depth, 1e3 * displacement_m, "magma_r", "displacement along the view in mm")
    _scale_bar(depth, mdf.side_m)
    relief.imshow(_shaded(displacement_m, mdf, number), cmap="gray", vmin=0, vmax=1, interpolation="nearest")
    relief.set_title("shaded relief", fontsize=10)
    _show(deviation, 1e6 * np.sqrt(mdf.variance_m2[number]), "viridis", "standard deviation in um", log=True)
    box, most = _box(merged), len(told["sweeps"])
    _show(agreed, merged.used[box], "viridis", "laser locations that agree, per pixel", limits=(0, most))
    _show(rejected, merged.rejected[box], "inferno", "laser locations that contradict, per pixel", limits=(0, most))
    _draw_sweeps(sweeps, told["sweeps"])
    for axes in (depth, relief, deviation, agreed, rejected):
        axes.set(xticks=[], yticks=[], facecolor="0.5")
    measured = float(np.isfinite(displacement_m).mean())
    figure.suptitle(f"{told['view']}: {measured:.1%} of the texels measured from {len(told['sweeps'])} laser locations")
    figure.savefig(path, dpi=90)


def _show(
    axes: Axes,
    values: NDArray[np.generic],
    colours: str,
    title: str,
    *,
    limits: tuple[float, float] | None = None,
    log: bool = False,
) -> None:
    """An image with its colour bar; without limits those that hold all but a few values."""
    if limits is None:
        known = values[np.isfinite(values)]
        low, high = np.percentile(known, (0.5, 99.5)) if known.size else (0.0, 1.0)
        limits = (max(low, 1e-3) if log else low, max(high, low + 1e-3))
    shown = axes.imshow(values, cmap=colours, norm="log" if log else "linear", clim=limits, interpolation="nearest")
    axes.set_title(title, fontsize=10)
    figure = axes.get_figure()
    assert figure is not None
    figure.colorbar(shown, ax=axes, shrink=0.8)


def _scale_bar(axes: Axes, side_m: float) -> None:
    texels = axes.get_images()[0].get_size()[0]
    length_mm = max((mm for mm in _NICE_MM if mm <= 250 * side_m), default=_NICE_MM[0])
    length = length_mm / (1e3 * side_m) * texels
    axes.plot([0.04 * texels, 0.04 * texels + length], [0.95 * texels] * 2, color="white", linewidth=4)
    axes.annotate(f"{length_mm} mm", (0.04 * texels, 0.93 * texels), color="white", fontsize=9)


def _shaded(displacement_m: NDArray[np.float32], mdf: Mdf, number: int) -> NDArray[np.float64]:
    """Lambert's cosine on the surface as the view's texels have it; NaN where a neighbour is missing."""
    height_m = -float(mdf.view_directions[number, 2]) * displacement_m.astype(np.float64)
    down, right = np.gradient(height_m, mdf.side_m / len(height_m))
    normal = np.stack([-right, down, np.ones_like(down)], axis=-1)  # row 0 lies at +Y
    return np.asarray(np.clip(normal @ _SUN / np.linalg.norm(normal, axis=-1), 0.0, 1.0))


def _box(merged: Merged) -> tuple[slice, slice]:
    """Rows and columns of the image that hold everything that was measured."""
    spans = []
    for axis in (1, 0):
        touched = np.flatnonzero(merged.used.any(axis=axis))
        spans.append(slice(int(touched[0]), int(touched[-1]) + 1) if touched.size else slice(None))
    return spans[0], spans[1]


def _draw_sweeps(axes: Axes, sweeps: Sequence[Mapping[str, Any]]) -> None:
    """Deviation from the merged surface and share of the pixels, of every laser location."""
    places = np.arange(len(sweeps))
    consistency = [np.nan if s["consistency"] is None else s["consistency"] for s in sweeps]
    labels = [f"{s['laser_azimuth_deg']:+g} / {s['laser_elevation_deg']:g}" for s in sweeps]
    axes.barh(places - 0.2, consistency, 0.4, color="C0", label="deviation from what all agree on, in sigmas")
    axes.barh(places + 0.2, [s["completeness"] for s in sweeps], 0.4, color="C2", label="share of pixels measured")
    for place, sweep in enumerate(sweeps):
        if sweep["status"] != "OK":
            axes.annotate(sweep["status"], (0.02, place), color="C3", fontsize=8, va="center")
    axes.axvline(1.0, color="0.6", linewidth=1, linestyle=":")
    axes.set_yticks(places, labels, fontsize=7)
    axes.invert_yaxis()
    axes.set_title("laser's azimuth / elevation in degrees", fontsize=10)
    axes.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.06))
