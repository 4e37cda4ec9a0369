"""Pictures of a calibrated rig: what its corners leave over, and where cameras, boards and axis stand."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure  # not pyplot, whose figures all threads share
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from processing import geometry
from processing.cameras.board import Board
from processing.cameras.calibration import CameraModel, Residuals, Survey

Array = NDArray[np.float64]
_COLUMNS = 4
_ARROW = 0.06  # of the picture's width: an error of the size in the title
_ABOVE, _SIDE = (0, 1), (0, 2)  # the rig frame's axes across and up


def draw_residuals(survey: Survey, out: Path) -> None:
    """Predicted less found corners of every camera as arrows, all enlarged alike; left-out corners are crosses."""
    rows = -(-len(survey.cameras) // _COLUMNS)
    columns = min(len(survey.cameras), _COLUMNS)
    figure = Figure(figsize=(3.8 * columns, 3.3 * rows + 0.4), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False)
    kept = np.concatenate([np.linalg.norm(r.error_px[r.accepted], axis=1) for r in survey.residuals.values()])
    unit_px = float(np.percentile(kept, 95))
    for panel in panels.flat:
        panel.axis("off")
    for panel, (name, residuals) in zip(panels.flat, survey.residuals.items(), strict=False):
        panel.axis("on")
        _draw_residuals(panel, name, survey.cameras[name], residuals, unit_px)
    figure.suptitle(f"predicted less found corners; the red bar is {unit_px:.2g} px, crosses are left out")
    figure.savefig(out, dpi=100)


def _draw_residuals(panel: Axes, name: str, camera: CameraModel, residuals: Residuals, unit_px: float) -> None:
    height, width = camera.size
    enlarged = _ARROW * width / unit_px
    uv_px, error_px = residuals.uv_px[residuals.accepted], residuals.error_px[residuals.accepted]
    panel.quiver(*uv_px.T, *(error_px * enlarged).T, angles="xy", scale_units="xy", scale=1, width=0.003, color="C0")
    panel.plot(*residuals.uv_px[~residuals.accepted].T, "x", color="C3", markersize=4)
    panel.plot([0.04 * width, (0.04 + _ARROW) * width], [0.95 * height] * 2, color="C3", linewidth=2)
    panel.set(xlim=(0, width), ylim=(height, 0), aspect="equal", xticks=[], yticks=[])
    left_out = np.count_nonzero(~residuals.accepted)
    panel.set_title(f"{name}: rms {camera.rms_px:.2f} px, {left_out} of {len(residuals.uv_px)} left out", fontsize=9)


def draw_network(survey: Survey, board: Board, out: Path) -> None:
    """Cameras, boards and the turntable's axis from above and from the side, whole and near the sample."""
    figure = Figure(figsize=(12, 9), layout="constrained")
    panels = figure.subplots(2, 2)
    reach_mm = 1.1e3 * max(float(np.linalg.norm(camera.centre_m)) for camera in survey.cameras.values())
    for column, (plane, title) in enumerate(((_ABOVE, "from above"), (_SIDE, "from the side"))):
        whole, near = panels[:, column]
        for name, camera in survey.cameras.items():
            _draw_camera(whole, name, camera, plane, 0.09 * reach_mm)
        for panel in (whole, near):
            _draw_boards(panel, survey.boards, board, plane)
            _draw_axis(panel, plane, survey.axis is not None)
            panel.set(xlabel="x in mm", ylabel=f"{'xyz'[plane[1]]} in mm", aspect="equal")
            panel.grid(alpha=0.3)
            panel.xaxis.set_major_locator(MaxNLocator(6))
        half_mm = 0.75e3 * board.square_m * max(board.columns, board.rows)
        near.set(xlim=(-half_mm, half_mm), ylim=(-half_mm, half_mm))
        whole.set_title(title)
        near.set_title(f"{title}, near the sample: boards, pose 0 filled")
    figure.suptitle(_axis_text(survey))
    figure.savefig(out, dpi=100)


def _draw_camera(panel: Axes, name: str, camera: CameraModel, plane: tuple[int, int], length_mm: float) -> None:
    """The camera's centre, the pyramid of its picture, its line of sight to the sample."""
    rows, columns = camera.size
    corners = np.array([[0, 0], [columns - 1, 0], [columns - 1, rows - 1], [0, rows - 1], [0, 0]], np.float64)
    centre = 1e3 * camera.centre_m
    edges = centre + length_mm * camera.rays(corners)
    middle = centre + 0.97 * float(np.linalg.norm(centre)) * camera.rays(corners[:4].mean(axis=0))
    panel.plot(*_flat([centre, middle], plane), color="C0", linewidth=0.5, alpha=0.5)
    panel.plot(*_flat(edges, plane), color="C0", linewidth=1)
    for edge in edges[:4]:
        panel.plot(*_flat([centre, edge], plane), color="C0", linewidth=1)
    panel.annotate(
        name,
        (centre[plane[0]], centre[plane[1]]),
        textcoords="offset points",
        xytext=(4, 4),
        fontsize=8,
        rotation=60 if plane == _ABOVE else 0,
    )


def _draw_boards(panel: Axes, boards: Mapping[int, Array], board: Board, plane: tuple[int, int]) -> None:
    half = 0.5 * board.square_m * np.array([board.columns, board.rows])
    outline = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [-1, -1, 0]]) * [*half, 0]
    for pose, rig_from_board in boards.items():
        flat = _flat(1e3 * geometry.transform_points(rig_from_board, outline), plane)
        if pose == 0:
            panel.fill(*flat, color="C1", alpha=0.4)
        panel.plot(*flat, color="C1", linewidth=1, alpha=0.8)


def _draw_axis(panel: Axes, plane: tuple[int, int], found: bool) -> None:
    if plane == _ABOVE:
        panel.plot(0, 0, "+", color="C3", markersize=12)
    else:
        panel.axvline(0, color="C3", linewidth=1.2, linestyle="-" if found else ":")
    panel.annotate("axis", (0, 0), textcoords="offset points", xytext=(5, -12), color="C3", fontsize=8)


def _axis_text(survey: Survey) -> str:
    if survey.axis is None:
        return "no board was turned: the board of pose 0 stands for the turntable's axis"
    tilt_deg = np.degrees(survey.axis.tilt_rad)
    sigma_deg = np.degrees(np.linalg.norm(survey.axis.tilt_deviation_rad))
    off_mm, sigma_mm = 1e3 * np.linalg.norm(survey.axis.point_m), 1e3 * np.linalg.norm(survey.axis.place_deviation_m)
    return (
        f"axis to the board's normal: {tilt_deg:.4f} +- {sigma_deg:.4f} deg; "
        f"axis to the board's centre: {off_mm:.4f} +- {sigma_mm:.4f} mm"
    )


def _flat(points: object, plane: tuple[int, int]) -> Array:
    return np.asarray(points, np.float64)[:, list(plane)].T
