"""The picture of all benchmarks: run time against error, ours beside the peers."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
from numpy.typing import NDArray

Row = Mapping[str, Any]
_WIDTH_IN, _HEAD_IN, _LABEL_IN = 10.0, 1.5, 0.21
_MARKERS = "osD^v"
_CLOSE = 0.01
_NARROW = 2.0


def draw_report(records: Sequence[Path], picture: Path) -> int:
    """Write the picture of all records that have rows with run time and error; count the points."""
    panels = [panel for path in records for panel in _panels(path)]
    report_figure(panels).savefig(picture, dpi=120)
    return sum(len(rows) for _, rows in panels)


def report_figure(panels: Sequence[tuple[str, Sequence[Row]]]) -> Figure:
    """A panel per benchmark: its title, and rows with method, seconds and error.

    The points of one method on several sizes are joined. Peers are hollow, references (textbook formulas) dotted;
    a line marks the `bound` where rows carry one.
    """
    heights = [_HEAD_IN + _LABEL_IN * max(8, len({row["method"] for row in rows})) for _, rows in panels] or [2.0]
    figure = Figure(figsize=(_WIDTH_IN, sum(heights)), layout="constrained")
    if not panels:
        figure.text(0.5, 0.5, "no record with run time and error", ha="center")
    else:
        grid = figure.subplots(len(panels), 1, height_ratios=heights, squeeze=False)[:, 0]
        for axes, (title, rows) in zip(grid, panels, strict=True):
            _draw_panel(axes, title, rows)
    return figure


def _panels(path: Path) -> list[tuple[str, list[Row]]]:
    """Title and rows of a record's panels, one for each `part` that its rows name."""
    record = json.loads(path.read_text(encoding="utf-8"))
    rows = [row for row in record["rows"] if "parameter" not in row]  # those have a picture of their own
    rows = [row for row in rows if (row.get("seconds") or 0) > 0 and (row.get("error") or 0) > 0]
    title = str(record["bench"]) + (" (quick)" if record.get("quick") else "")
    parts = dict.fromkeys(row.get("part", "") for row in rows)
    return [
        (f"{title}: {part}" if part else title, [row for row in rows if row.get("part", "") == part]) for part in parts
    ]


def _draw_panel(axes: Axes, title: str, rows: Sequence[Row]) -> None:
    sizes = list(dict.fromkeys(str(row.get("size", "")) for row in rows))
    methods = {row["method"]: [r for r in rows if r["method"] == row["method"]] for row in rows}
    unit = f" in {rows[0]['unit']}" if "unit" in rows[0] else ""
    axes.set(xscale="log", yscale="log", xlabel="run time in s", ylabel=f"error{unit}")
    axes.set_title(title, loc="left")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())
    bounds = {float(row["bound"]) for row in rows if "bound" in row}
    for bound in bounds:
        axes.axhline(bound, color="0.4", linewidth=1, linestyle="--", zorder=1)
    colours = {method: f"C{number % 10}" for number, method in enumerate(methods)}
    for method, points in methods.items():
        _draw_method(axes, points, sizes, colours[method])
    if sizes != [""]:
        for size, marker in zip(sizes, _MARKERS, strict=False):
            axes.plot([], [], marker, color="0.4", label=size)
        axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=len(sizes), fontsize=8, frameon=False)
    axes.margins(0.08, 0.1)
    errors = [float(row["error"]) for row in rows]
    if bounds == {1.0}:
        _show_distance_from_one(axes, errors)
    elif max(errors) < _NARROW * min(errors):  # nearly equal: not to look far apart
        axes.set_ylim(min(errors) / _NARROW, max(errors) * _NARROW)
    axes.grid(alpha=0.3)
    _label(axes, methods, colours)


def _show_distance_from_one(axes: Axes, errors: Sequence[float]) -> None:
    """An error scale that is linear within a percent of the bound and logarithmic in the distance from it beyond."""
    axes.set_yscale("function", functions=(_from_one, lambda place: 1 + _CLOSE * np.sinh(place)))
    shown = (0.9, 0.97, 0.99, 1, 1.01, 1.03, 1.1, 1.3, 2, 4, 10, 30, 100, 1000)
    ticks = [tick for tick in shown if min(*errors, 1) - _CLOSE / 2 <= tick < 2 * max(errors)]
    axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_ylabel("error over the bound")


def _from_one(error: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.arcsinh((np.asarray(error) - 1) / _CLOSE), np.float64)


def _draw_method(axes: Axes, rows: Sequence[Row], sizes: Sequence[str], colour: str) -> None:
    seconds, errors = ([float(row[key]) for row in rows] for key in ("seconds", "error"))
    if all("size" in row for row in rows):
        style = ":" if rows[0].get("reference") else "-"
        axes.plot(seconds, errors, color=colour, linewidth=1, linestyle=style, zorder=2)
    for row, x, y in zip(rows, seconds, errors, strict=True):
        marker = _MARKERS[sizes.index(str(row.get("size", ""))) % len(_MARKERS)]
        face = "white" if row.get("peer") else colour
        axes.scatter(x, y, s=45, marker=marker, facecolors=face, edgecolors=colour, linewidths=1.5, zorder=3)


def _label(axes: Axes, methods: Mapping[str, Sequence[Row]], colours: Mapping[str, str]) -> None:
    """Names in a column at the right, in the order of the errors, each with a thin line to its slowest point."""
    ends = {name: max(rows, key=lambda row: float(row["seconds"])) for name, rows in methods.items()}
    names = sorted(ends, key=lambda name: (float(ends[name]["error"]), float(ends[name]["seconds"])))
    to_axes = (axes.transScale + axes.transLimits).transform
    wanted = np.array([to_axes((float(ends[name]["seconds"]), float(ends[name]["error"])))[1] for name in names])
    for name, place in zip(names, spread(wanted, 1 / max(len(names), 8)), strict=True):
        end, colour = ends[name], colours[name]
        weight = "normal" if end.get("peer") else "bold"
        axes.annotate(
            name, (float(end["seconds"]), float(end["error"])), xytext=(1.04, place), textcoords="axes fraction",
            va="center", fontsize=9, color=colour, fontweight=weight, annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.5, "relpos": (0, 0.5), "shrinkB": 4},
        )  # fmt: skip


def spread(places: NDArray[np.float64], gap: float) -> NDArray[np.float64]:
    """Rising places from 0 to 1, a gap apart, as near to the wanted ones as that allows; under 0 where it does not."""
    free = np.clip(places, 0, 1)
    for i in range(1, len(free)):
        free[i] = max(free[i], free[i - 1] + gap)
    excess = max(free[-1] - 1, 0.0)
    free[-1] -= excess
    for i in range(len(free) - 2, -1, -1):
        free[i] = min(free[i], free[i + 1] - gap)
    return free
