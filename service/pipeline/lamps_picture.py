"""The picture of a lamps session: where the lamps are, how well that is known, and what the highlights leave over."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from numpy.typing import NDArray

from processing.lamps.mirror import MirrorFit, Sighting
from processing.lamps.model import LampModel, LampStatus, NominalLamp

Array = NDArray[np.float64]
_COLOURS = {LampStatus.MEASURED: "C0", LampStatus.DISTANCE_ASSUMED: "C1", LampStatus.NOT_MEASURED: "C3"}
_SIGMAS = 10.0  # ellipses are drawn this many times as large as one deviation, or they could not be seen


def draw_lamps(
    path: Path,
    models: Mapping[str, LampModel],
    nominal: Mapping[str, NominalLamp],
    sightings: Sequence[Sighting],
    mirror: MirrorFit | None,
) -> None:
    """Lamps from above and from the side, deviation of each, and found less predicted highlights of each camera."""
    figure = Figure(figsize=(12, 9), layout="constrained")
    above, aside, deviations, left = figure.subplots(2, 2).flat
    _draw_places(above, models, nominal, (0, 1))
    above.set(title="from above, carriers at 0", xlabel="X in m", ylabel="Y in m")
    _draw_places(aside, models, nominal, (0, 2))
    aside.set(title="from the side, carriers at 0", xlabel="X in m", ylabel="Z in m")
    aside.set_aspect("equal")
    _draw_deviations(deviations, models)
    _draw_residuals(left, sightings, mirror)
    figure.savefig(path, dpi=100)


def _draw_places(
    axes: Axes, models: Mapping[str, LampModel], nominal: Mapping[str, NominalLamp], shown: tuple[int, int]
) -> None:
    axes.plot(0, 0, "k+", markersize=10)
    pick = np.array(shown)
    for name, model in models.items():
        place, label = model.position_m[pick], nominal[name].position_m[pick]
        axes.plot(*label, "o", markerfacecolor="none", color="0.6")
        axes.plot(*place, ".", color=_COLOURS[model.status])
        axes.annotate(name, place, fontsize=8, xytext=(4, 4), textcoords="offset points")
        variances, vectors = np.linalg.eigh(model.covariance_m2[np.ix_(pick, pick)])
        extent = 2 * _SIGMAS * np.sqrt(np.maximum(variances, 0.0))
        angle_deg = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
        axes.add_patch(Ellipse(place, extent[1], extent[0], angle=angle_deg, fill=False, color=_COLOURS[model.status]))
    axes.grid(alpha=0.3)
    axes.text(0.02, 0.02, f"circles: nominal; ellipses: {_SIGMAS:g} deviations", fontsize=8, transform=axes.transAxes)


def _draw_deviations(axes: Axes, models: Mapping[str, LampModel]) -> None:
    """Direction in degrees, distance in percent; lamps that were not measured stand out by what was believed."""
    names, every = list(models), np.arange(len(models))
    direction = [np.degrees(model.direction_deviation_rad) for model in models.values()]
    distance = [100 * model.distance_deviation_m / model.distance_m for model in models.values()]
    axes.bar(every - 0.2, direction, 0.4, label="direction in deg")
    axes.bar(every + 0.2, distance, 0.4, label="distance in %")
    axes.set_xticks(every, names, fontsize=8)
    axes.set(yscale="log", title="one deviation")
    axes.legend(fontsize=8)
    axes.grid(axis="y", alpha=0.3)
    for number, model in enumerate(models.values()):
        if model.status != LampStatus.MEASURED:
            axes.text(number, 1.5 * max(direction[number], distance[number]), model.status.name.lower(), fontsize=7)


def _draw_residuals(axes: Axes, sightings: Sequence[Sighting], mirror: MirrorFit | None) -> None:
    axes.set(title="highlights, found less predicted", xlabel="columns in px", ylabel="rows in px")
    axes.grid(alpha=0.3)
    if mirror is None:
        axes.text(0.5, 0.5, "no mirror ball in this session", ha="center", transform=axes.transAxes)
        return
    for number, camera in enumerate(sorted({sighting.camera for sighting in sightings})):
        mine = np.array([sighting.camera == camera for sighting in sightings]) & (mirror.weight > 0)
        axes.plot(*mirror.residual_px[mine].T, ".", color=f"C{number}", label=camera)
    axes.axhline(0, color="0.7", zorder=0)
    axes.axvline(0, color="0.7", zorder=0)
    axes.set_aspect("equal")
    axes.legend(fontsize=8)
