"""A laser's stripe in photographs and in a sweep that others took, beside other estimators on the same stripes.

A laser's plane crosses a flat board in a line, which lens distortion bends smoothly: what a method leaves over about a
quadratic along the stripe is its own error. Errors are in pixels, RMS per image, mean over images. Peers take each row
by itself, as their authors do, in a window around the stripe, which ours has to find; ours averages over rows.
"""

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter1d

from processing import geometry
from processing.laser.hand_sweep import laser_sweep
from processing.laser.laser_chessboard import BoardStripe, LaserChessboard, bend_residual, laser_chessboard
from processing.laser.plane_fit import fit_plane
from processing.laser.ridge import stripe_ridge
from processing.laser.stripe import redness, stripe_line
from service.bench import Result
from tests.benchmarks.yardsticks.bandwidth import fastest
from tests.benchmarks.yardsticks.stripe_peers import argmax, blais_rioux, centre_of_mass, log_parabola, parabola
from tests.public_data import DATA
from tests.reference.ridge import ridge_points

SIGMA_PX, THRESHOLD = 4.0, 4.0  # of the ridge in laser_chessboard
WINDOW_PX = 20
SMOOTH_PX = (0.0, 1.0, 2.0, 4.0)  # along the row, before a peer: the best one counts
PEERS = {
    "argmax": argmax, "parabola": parabola, "centre of mass": centre_of_mass, "log-parabola": log_parabola,
    "Blais-Rioux": blais_rioux,
}  # fmt: skip


def run(*, quick: bool) -> Result:
    """Stripes on a chessboard, and a sweep by hand; quick with fewer repeats."""
    boards, sweep = DATA / "laser-chessboard", DATA / "laser-sweep"
    figures: dict[str, float] = {}
    rows: list[dict[str, object]] = []
    if boards.is_dir():
        found = laser_chessboard(boards)
        distance_m = found.plane.distance(found.points_m)
        figures = {
            "real_stripe_residual_px": found.row_rms_px,
            "real_plane_residual_mm": float(np.sqrt(np.mean(distance_m**2))) * 1e3,
        }
        images = [redness(np.asarray(Image.open(boards / stripe.image))) for stripe in found.stripes]
        rows += [_our_row(found, images[0], quick=quick), *peer_rows(found, images), *plane_rows(found)]
    else:
        rows.append({"method": "stripes on a chessboard", "missing": "the public data laser-chessboard are not here"})
    if sweep.is_dir():
        rows += _sweep_rows(sweep / "input.gif", sweep / "intrinsics.xml")
    else:
        rows.append({"method": "sweep by hand", "missing": "the public data laser-sweep are not here"})
    return Result(figures, rows)


def _our_row(found: LaserChessboard, image: np.ndarray, *, quick: bool) -> dict[str, object]:
    """Ours; in full also how long the same takes in SciPy's filters."""
    seconds = fastest(lambda: stripe_ridge(image, SIGMA_PX, THRESHOLD), 3 if quick else 15)
    residuals = [bend_residual(stripe.uv_px)[0] for stripe in found.stripes]
    row = _row("ours: ridge", residuals, found.plane.rms_m)
    row |= {"seconds": seconds, "size": f"{image.shape[1]} x {image.shape[0]}", "settings": f"sigma {SIGMA_PX:g} px"}
    if not quick:
        everywhere = np.ones(image.shape, bool)
        row["seconds_in_scipy"] = fastest(lambda: ridge_points(image, SIGMA_PX, THRESHOLD, everywhere), 3)
    return row


def peer_rows(found: LaserChessboard, images: list[np.ndarray]) -> list[dict[str, object]]:
    """Each peer on windows around the same stripes, smoothed as suits it best."""
    windows = [_window(image, stripe) for image, stripe in zip(images, found.stripes, strict=True)]
    rows = []
    for name, find in PEERS.items():
        tried = [_peer_row(name, find, found, windows, smooth_px) for smooth_px in SMOOTH_PX]
        rows.append(min(tried, key=lambda row: float(str(row["error"]))))
    return rows


def _window(image: np.ndarray, stripe: BoardStripe) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Profiles (n, 2 WINDOW_PX + 1) across the stripe, the column of each one's start, the rows."""
    line = stripe_line(stripe.uv_px, 8.0)
    rows = np.unique(np.rint(stripe.uv_px[:, 1]).astype(int))
    middle = (line.offset_px - line.normal[1] * rows) / line.normal[0]
    start = np.clip(np.rint(middle).astype(int) - WINDOW_PX, 0, image.shape[1] - 2 * WINDOW_PX - 1)
    return image[rows[:, None], start[:, None] + np.arange(2 * WINDOW_PX + 1)], start, rows


def _peer_row(name, find, found, windows, smooth_px) -> dict[str, object]:
    residuals, points = [], []

    def places(profiles):
        smooth = gaussian_filter1d(profiles, smooth_px, axis=1) if smooth_px else profiles
        return find(smooth.T[:, :, None], (SIGMA_PX, 0.0))[:, 0]

    for stripe, (profiles, start, rows) in zip(found.stripes, windows, strict=True):
        uv_px = np.stack([start + places(profiles), rows], axis=1)
        uv_px = uv_px[np.isfinite(uv_px).all(axis=1)]
        residual, good = bend_residual(uv_px)
        residuals.append(residual[good])
        rays = geometry.pixel_rays(uv_px[good], found.calibration.matrix, found.calibration.distortion, np.eye(4))
        points.append(stripe.board.cut(rays))
    seconds = fastest(lambda: places(windows[0][0]), 2)
    row = _row(name, residuals, fit_plane(np.concatenate(points)).rms_m)
    return row | {"peer": True, "seconds": seconds, "settings": f"row smoothed by {smooth_px:g} px", "size": "window"}


def _row(name: str, residuals: list[np.ndarray], plane_rms_m: float) -> dict[str, object]:
    """Residuals per image, and how they are distributed over all points."""
    per_image = [float(np.sqrt(np.mean(residual**2))) for residual in residuals]
    median, p95, largest = (float(v) for v in np.percentile(np.abs(np.concatenate(residuals)), (50, 95, 100)))
    return {"method": name, "error": float(np.mean(per_image)), "unit": "px", "median": median, "p95": p95,
            "largest": largest, "worst_image": max(per_image), "best_image": min(per_image),
            "points": sum(map(len, residuals)), "plane_rms_mm": plane_rms_m * 1e3}  # fmt: skip


def plane_rows(found: LaserChessboard) -> list[dict[str, object]]:
    """How well the plane of all other images predicts each image's points, and how far the published one is."""
    missed = []
    for left in found.stripes:
        others = fit_plane(np.concatenate([stripe.points_m for stripe in found.stripes if stripe is not left]))
        missed.append(others.distance(left.points_m))
    per_image = [float(np.sqrt(np.mean(one**2))) * 1e3 for one in missed]
    return [
        {"check": "plane of the other images, mm", "value": float(np.sqrt(np.mean(np.concatenate(missed) ** 2))) * 1e3,
         "worst_image": max(per_image), "best_image": min(per_image)},
        {"check": "angle to the published plane, deg", "value": float(np.degrees(found.published_angle_rad)),
         "our_sigma": float(np.degrees(found.angle_deviation_rad))},
        {"check": "mean distance from the published plane, mm", "value": found.published_distance_m * 1e3,
         "our_sigma": found.distance_deviation_m * 1e3},
    ]  # fmt: skip


def _sweep_rows(gif, intrinsics) -> list[dict[str, object]]:
    """The corner of wall and table, whose angle nobody measured, by the published camera and by the rectangles' own."""
    rows = []
    for camera, path in (("published", intrinsics), ("of the rectangles", None)):
        found = laser_sweep(gif, path)
        rows.append(
            {"check": f"corner of the hand-swept scene, deg, camera {camera}",
             "value": float(np.degrees(found.fit.corner_rad)),
             "our_sigma": float(np.degrees(found.fit.corner_deviation_rad)), "sides_px": found.fit.rms_px,
             "wall_mm": found.wall_rms_m * 1e3, "table_mm": found.floor_rms_m * 1e3,
             "points": int(np.isfinite(found.depth_m).sum()), "timed": int(found.timed.sum()),
             "time_to_ridge_mm": found.disagreement_m * 1e3}
        )  # fmt: skip
    return rows
