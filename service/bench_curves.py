"""The picture of one benchmark's variations: error over each parameter, a line per method, ours beside the peers."""

import json
from collections.abc import Mapping, Sequence
from itertools import chain, cycle
from pathlib import Path
from string import ascii_lowercase
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import LogLocator, NullFormatter, NullLocator

from service.bench_report import spread

Row = Mapping[str, Any]
_Point = tuple[float, float]
_COLUMNS, _PANEL_IN = 3, (5.4, 3.5)
# Told apart by all kinds of colour vision (Okabe and Ito 2008), but for black, which is ours.
_COLOURS = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_OURS = ("#000000", "#888888")
_BOUND, _REFERENCE = "0.35", "0.5"
_WIDE = 8.0  # largest over smallest value from which an axis is logarithmic
_TICKS = 12  # values that are told one by one on a logarithmic axis
_ALL = 0.9  # share of values measured under which a point is hollow


def draw_curves(record: Path, picture: Path) -> bool:
    """Write the picture of a record's rows that name a `parameter`; whether there were any."""
    content = json.loads(record.read_text(encoding="utf-8"))
    rows = [row for row in content["rows"] if "parameter" in row]
    if not _panels(rows):
        return False
    title = str(content["bench"]) + (" (quick)" if content.get("quick") else "")
    curves_figure(title, rows).savefig(picture, dpi=120)
    return True


def curves_figure(title: str, rows: Sequence[Row]) -> Figure:
    """A panel per parameter that was varied: error over its value, a line per method, named at its end; bounds dashed.

    Our methods are black and grey, peers coloured, references (what is no method) dotted and dashed. A point is hollow
    where under nine tenths were `measured`.
    """
    parts = {
        part: [row for row in rows if row.get("part") == part] for part in dict.fromkeys(r.get("part") for r in rows)
    }
    looks = {part: _looks(found) for part, found in parts.items()}
    panels = [(part, panel) for part, found in parts.items() for panel in _panels(found)]
    down, across = -(-len(panels) // _COLUMNS), min(len(panels), _COLUMNS)
    layout = ConstrainedLayoutEngine(wspace=0.03, hspace=0.06)
    figure = Figure(figsize=(_PANEL_IN[0] * across, _PANEL_IN[1] * down), layout=layout)
    figure.suptitle(f"{title}: error over what was varied, dashed the bound, hollow where values are missing")
    grid = figure.subplots(down, across, squeeze=False).ravel()
    for letter, (part, panel), axes in zip(cycle(ascii_lowercase), panels, grid, strict=False):
        _draw_panel(axes, panel, looks[part])
        axes.set_title(letter, loc="left", fontweight="bold")
    for axes in grid[len(panels) :]:
        axes.set_axis_off()
    return figure


def _panels(rows: Sequence[Row]) -> list[list[Row]]:
    """Rows of each parameter that was varied."""
    panels = [[row for row in rows if row["parameter"] == name] for name in dict.fromkeys(r["parameter"] for r in rows)]
    return [panel for panel in panels if len({row["value"] for row in panel}) > 1]


def _looks(rows: Sequence[Row]) -> dict[str, tuple[str, str]]:
    """One colour and line style for each method in all panels of a part, in the order in which methods appear."""
    peers = chain(((colour, "-") for colour in _COLOURS), cycle((colour, ":") for colour in _COLOURS))
    ours = chain(((colour, "-") for colour in _OURS), cycle((colour, ":") for colour in _OURS))
    found: dict[str, tuple[str, str]] = {}
    for row in rows:
        if row["method"] not in found:
            aside = (_REFERENCE, "-.") if row.get("reference") else None
            found[str(row["method"])] = aside or next(peers if row.get("peer") else ours)
    return found


def _draw_panel(axes: Axes, rows: Sequence[Row], looks: Mapping[str, tuple[str, str]]) -> None:
    shown = [row for row in rows if (row.get("error") or 0) > 0]
    unit = f" in {rows[0]['unit']}" if "unit" in rows[0] else ""
    axes.set(xlabel=rows[0]["parameter"], ylabel=f"error{unit}", yscale="log")
    places = _places(axes, list(dict.fromkeys(row["value"] for row in rows)))
    ends = [("bound", bound[-1], _BOUND) for bound in _draw_bounds(axes, rows, places)]
    for method, look in looks.items():
        points = [row for row in shown if row["method"] == method]
        if points:
            line = [(places[row["value"]], float(row["error"])) for row in points]
            _draw_line(axes, line, points, look)
            ends.append((method, line[-1], look[0]))
    axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    axes.margins(0.03, 0.06)
    _label(axes, ends)


def _draw_bounds(axes: Axes, rows: Sequence[Row], places: Mapping[float | str, float]) -> set[tuple[_Point, ...]]:
    """The lines of what the rows say is the bound; methods on the same input share one."""
    told: dict[str, list[_Point]] = {}
    for row in rows:
        if "bound" in row:
            told.setdefault(str(row["method"]), []).append((places[row["value"]], float(row["bound"])))
    lines = {tuple(points) for points in told.values()}
    for line in lines:
        axes.plot(*zip(*line, strict=True), "--", color=_BOUND, linewidth=1.3, zorder=5)
    return lines


def _places(axes: Axes, values: Sequence[float | str]) -> Mapping[float | str, float]:
    """Where values stand on the axis: names side by side, numbers of one sign over decades by their logarithms."""
    if any(isinstance(value, str) for value in values):
        axes.set_xticks(range(len(values)), [str(value) for value in values])
        return {value: float(place) for place, value in enumerate(values)}
    places = {value: float(value) for value in values}
    if min(places.values()) > 0 and max(places.values()) > _WIDE * min(places.values()):
        axes.set_xscale("log")
        if len(places) > _TICKS:
            axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axes.xaxis.set_major_formatter(lambda place, _: _short(place))
        else:
            axes.set_xticks(list(places.values()), [_short(place) for place in places.values()], fontsize=8)
        axes.xaxis.set_minor_locator(NullLocator())
    return places


def _short(value: float) -> str:
    return f"{value:g}" if value < 1e3 else f"{value / 1e3:.3g}k" if value < 1e6 else f"{value / 1e6:.3g}M"


def _draw_line(axes: Axes, line: Sequence[_Point], points: Sequence[Row], look: tuple[str, str]) -> None:
    (x, y), (colour, style) = zip(*line, strict=True), look
    if points[0].get("reference"):
        axes.plot(x, y, style, color=colour, linewidth=1.3, zorder=5)
        return
    peer = bool(points[0].get("peer"))
    axes.plot(x, y, style, color=colour, linewidth=1.3 if peer else 2.4, zorder=3 if peer else 4)
    faces = ["white" if row.get("measured", 1.0) < _ALL else colour for row in points]
    axes.scatter(x, y, s=16 if peer else 26, c=faces, edgecolors=colour, zorder=4 if peer else 5)


def _label(axes: Axes, ends: Sequence[tuple[str, _Point, str]]) -> None:
    """Names in a column at the right, in the order of the lines' ends, each in its colour and joined to its own."""
    ordered = sorted(ends, key=lambda end: end[1][1])
    to_axes = (axes.transScale + axes.transLimits).transform
    wanted = np.array([to_axes(point)[1] for _, point, _ in ordered])
    for (name, point, colour), place in zip(ordered, spread(wanted, min(0.075, 1 / len(ordered))), strict=True):
        axes.annotate(
            name, point, xytext=(1.05, place), textcoords="axes fraction", va="center", fontsize=8, color=colour,
            annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.5, "relpos": (0, 0.5), "shrinkB": 3},
        )  # fmt: skip
