"""Pictures of the analysis of a BTF: what it found step by step, its result beside the BTF, its error over the view."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import hsv_to_rgb
from matplotlib.figure import Figure  # not pyplot, whose figures all threads share
from numpy.typing import NDArray

from processing.products.arrays import Float32

Mask = NDArray[np.bool_]

_MOST = 95  # per cent of the shifts that are told apart by their colours


def draw_steps(path: Path, panels: Sequence[tuple[str, NDArray[np.floating]]]) -> None:
    """Pictures (h, w) in grey from 0 to 1, or (h, w, 3) in colour, two rows of them; NaN is red."""
    columns = -(-len(panels) // 2)
    figure = Figure(figsize=(3.1 * columns, 6.6), layout="constrained")
    axes = figure.subplots(2, columns, squeeze=False)
    grey = matplotlib.colormaps["gray"].with_extremes(bad="tab:red")
    for axis in axes.flat:
        axis.axis("off")
    for axis, (title, panel) in zip(axes.flat, panels, strict=False):
        axis.imshow(np.clip(panel, 0, 1), cmap=grey, vmin=0, vmax=1, interpolation="nearest")
        axis.set_title(title, fontsize=9)
    figure.savefig(path, dpi=110)


def shift_scale(shift: Float32, hidden: Mask) -> float:
    """Length in texels that all but a twentieth of the shifts (y, x, 2) of points that are seen stay under, 1 at least.

    The longest would let one point that matches by chance fade all others.
    """
    length = np.linalg.norm(shift[~hidden], axis=-1)
    return max(float(np.percentile(length, _MOST)), 1.0) if len(length) else 1.0


def shift_colours(shift: Float32, hidden: Mask, scale: float) -> Float32:
    """A shift field (y, x, 2): hue is its direction, strength its length up to `scale`; hidden points are black."""
    length = np.linalg.norm(shift, axis=-1)
    hue = (np.arctan2(-shift[..., 1], shift[..., 0]) / (2 * np.pi)) % 1
    seen = np.where(hidden, 0.0, 1.0)
    return np.asarray(hsv_to_rgb(np.stack([hue, np.clip(length / scale, 0, 1), seen], axis=-1)), np.float32)


def display(values: Float32, peak: float) -> Float32:
    """Linear values (h, w, 3) for the eye: `peak` becomes white, what is missing red."""
    missing = ~np.isfinite(values).all(axis=-1)
    shown = np.clip(np.nan_to_num(values) / max(peak, 1e-12), 0, 1) ** (1 / 2.2)
    shown[missing] = (0.84, 0.15, 0.16)
    return np.asarray(shown, np.float32)


def draw_table(path: Path, rows: Sequence[tuple[str, Sequence[Float32]]], titles: Sequence[str]) -> None:
    """Rows of colour pictures (h, w, 3) from 0 to 1, each row with its own name, each column with its title."""
    figure = Figure(figsize=(2.2 * len(titles) + 0.6, 2.2 * len(rows) + 0.4), layout="constrained")
    axes = figure.subplots(len(rows), len(titles), squeeze=False)
    for line, (name, pictures) in zip(axes, rows, strict=True):
        for axis, picture in zip(line, pictures, strict=True):
            axis.imshow(picture, interpolation="nearest")
            axis.set(xticks=[], yticks=[])
        line[0].set_ylabel(name, fontsize=8)
    for axis, title in zip(axes[0], titles, strict=True):
        axis.set_title(title, fontsize=9)
    figure.savefig(path, dpi=110)


def draw_errors(path: Path, polar_deg: NDArray[np.floating], errors: Mapping[str, NDArray[np.floating]]) -> None:
    """Relative squared error of each model (ring,) over the views' polar angle (ring,)."""
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    axis: Axes = figure.subplots()
    for (name, error), mark in zip(errors.items(), "os^Dv", strict=False):
        axis.plot(polar_deg, error, marker=mark, label=name)
    axis.set(xlabel="view from the normal in deg", ylabel="squared error over the squares of the BTF", yscale="log")
    axis.grid(which="both", alpha=0.3)
    axis.legend()
    figure.savefig(path, dpi=110)
