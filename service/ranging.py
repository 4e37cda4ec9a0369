"""`rig displacement`: range of laser images that this rig did not take. Each source yields the lines that it tells."""

from collections.abc import Callable, Iterable, Iterator
from math import degrees
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.formats.sequence import PictureFiles
from processing.laser.depth_picture import depth_picture, write_point_cloud
from processing.laser.hand_sweep import laser_sweep
from processing.laser.laser_chessboard import BoardCalibration
from processing.laser.motion import Motion
from processing.laser.printed_rectangles import RectangleFit
from processing.laser.profile_scan import Scan, ScanStatus, scan_profiles
from processing.laser.scan_check import MotionCheck, check_motion, merged_points, pass_disagreement
from processing.laser.stripe import LaserColour
from render.picture import save_image
from service.files import check_folder, replaced
from service.pictures import STILL, save_stripes
from service.scan_file import BOARD, open_scan, open_stripes

INTRINSICS = "intrinsics.xml"
SCAN, CALIBRATION = "scan.toml", "Calib_Results.mat"
CLOUDS = (".ply", ".glb")
_SLIPPED = 20.0  # sigmas between two turns from which on noise is no excuse

Track = Callable[[Iterable[int]], Iterable[int]]
Colours = NDArray[np.uint8]


def measure_displacement(source: Path, out: Path, track: Track = lambda items: items) -> Iterator[str]:
    """Range of a folder of stripe photographs, a hand-swept animation or a described scan (.toml, or its folder).

    `out` is the depth picture or the point cloud; the other one lies beside it, a cloud as PLY. `track` passes frame
    numbers on, for a progress bar. Nothing is written where something is wrong. Raises ImageError, CalibrationError,
    ConfigError.
    """
    if out.suffix.lower() not in (*STILL, *CLOUDS):
        raise ImageError(f"{out}: a picture is one of {', '.join(STILL)}, a point cloud one of {', '.join(CLOUDS)}.")
    check_folder(out)
    if source.is_dir():
        source = _described(source)
    kind = source.suffix.lower()
    if kind == ".mat" or source.name == BOARD:
        yield from _stripes(source.parent, out)
    elif kind == ".gif":
        yield from _sweep(source, out)
    elif kind == ".toml":
        yield from _scan(source, out, track)
    else:
        raise ImageError(
            f"{source}: a folder of laser-line photographs, the .gif of a sweep or the .toml of a scan is needed."
        )


def _described(folder: Path) -> Path:
    """The file that says what a folder's pictures are. Raises ImageError where there is none."""
    for name in (SCAN, BOARD, CALIBRATION):
        if (folder / name).exists():
            return folder / name
    raise ImageError(
        f"{folder}: neither {BOARD} or {CALIBRATION}, of photographs of the line on a chessboard, nor {SCAN}, of a "
        "turning or sliding object, is in it; docs/range-of-your-own-images.md says what they hold."
    )


def _stripes(folder: Path, out: Path) -> Iterator[str]:
    if (folder / BOARD).exists():  # else the pictures' names are fixed
        _check_apart(out, folder)
    found = open_stripes(folder, LaserColour.RED)
    if np.isfinite(found.calibration.corner_rms_px):
        yield from _about_camera(found.calibration)
    distances_m, normal = found.plane.distance(found.points_m), found.plane.normal
    yield (
        f"{len(found.stripes)} stripes on {len(found.calibration.photographs)} boards, {len(found.points_m)} points; "
        f"row residual {found.row_rms_px:.3f} px, plane residual {np.std(distances_m) * 1e3:.3f} mm"
    )
    yield (
        f"laser plane: normal = [{normal[0]:.6f}, {normal[1]:.6f}, {normal[2]:.6f}], "
        f"offset_mm = {found.plane.offset_m * 1e3:.4f}, to {degrees(found.angle_deviation_rad):.3f} deg and "
        f"{found.distance_deviation_m * 1e3:.3f} mm (one sigma)"
    )
    if np.isfinite(found.published_angle_rad):
        yield (
            f"published plane: {degrees(found.published_angle_rad):.3f} deg and "
            f"{found.published_distance_m * 1e3:.3f} mm away"
        )
    shade = depth_picture(found.points_m[None, :, 2])[0]
    yield from _write(out, lambda path: save_stripes(path, found.stripes), found.points_m, shade)


def _about_camera(found: BoardCalibration) -> Iterator[str]:
    yield (
        f"camera: matrix = {found.matrix.round(3).tolist()}, distortion = {found.distortion.round(6).tolist()}, "
        f"size_px = {list(found.size_px)}; corners {found.corner_rms_px:.3f} px off (rms)"
    )


def _check_apart(out: Path, folder: Path) -> None:
    """Raises ImageError where the result would lie among the pictures that it is made of."""
    if out.parent.resolve() == folder.resolve():
        raise ImageError(f"{out}: lies among the source's pictures, and would be one of them the next time.")


def _sweep(source: Path, out: Path) -> Iterator[str]:
    intrinsics = source.parent / INTRINSICS
    found = laser_sweep(source, intrinsics if intrinsics.exists() else None)
    measured = np.isfinite(found.depth_m)
    yield (
        f"{measured.mean():.1%} of the pixels measured, {found.timed.mean():.1%} by their time, others by the stripe's "
        f"ridge, {found.disagreement_m * 1e3:.2f} mm apart where both are; "
        f"wall {found.wall_rms_m * 1e3:.2f} mm and table "
        f"{found.floor_rms_m * 1e3:.2f} mm from their planes, {_corner(found.fit)} between them"
    )
    if found.own is found.fit:
        yield f"no {INTRINSICS}: by the rectangles, {_camera(found.fit)}"
    elif found.own is not None and found.own.contradicts(found.fit):
        yield (
            f"WARNING: {INTRINSICS} contradicts the rectangles, whose sides lie {found.fit.rms_px:.2f} px off with it. "
            f"Without it they say {_camera(found.own)}; the corner is {_corner(found.own)} then. Take the file away to "
            "go by the rectangles."
        )
    picture = depth_picture(found.depth_m)
    yield from _write(out, lambda path: save_image(path, picture), found.points_m, found.picture)


def _corner(fit: RectangleFit) -> str:
    return f"{degrees(fit.corner_rad):.1f} +- {degrees(fit.corner_deviation_rad):.1f} deg"


def _camera(fit: RectangleFit) -> str:
    matrix, distortion = fit.lens
    focal, across, down, bend = fit.deviation
    return (
        f"focal length {matrix[0, 0]:.0f} +- {focal:.0f} px, centre {matrix[0, 2]:.0f} +- {across:.0f} and "
        f"{matrix[1, 2]:.0f} +- {down:.0f} px, k1 {distortion[0]:.2f} +- {bend:.2f}, sides {fit.rms_px:.2f} px off"
    )


def _scan(source: Path, out: Path, track: Track) -> Iterator[str]:
    opened = open_scan(source)
    if isinstance(opened.frames, PictureFiles):
        _check_apart(out, opened.frames.files[0].parent)
    scan = scan_profiles(opened.frames, opened.setup, opened.backgrounds, track)
    yield from _about_scan(scan)
    if not scan.count(ScanStatus.MEASURED):
        raise ImageError(
            f"{source}: no measured point; above is what became of the stripe. If most is out of range, look at the "
            "signs of [laser_plane], at depth_mm and at radius_mm."
        )
    yield from _about_turns(scan, opened.setup.motion)
    yield _about_motion(check_motion(opened.frames, scan, opened.setup))
    depth_m = opened.setup.motion.depth(scan.points_m)
    picture = depth_picture(depth_m.T if opened.setup.upright else depth_m)
    yield from _write(out, lambda path: save_image(path, picture), *merged_points(scan))


def _about_scan(scan: Scan) -> Iterator[str]:
    measured = scan.status == ScanStatus.MEASURED
    others = {
        "no stripe": ScanStatus.NO_STRIPE,
        "two stripes": ScanStatus.TWO_STRIPES,
        "out of range": ScanStatus.OUT_OF_RANGE,
        "isolated": ScanStatus.ISOLATED,
    }
    told = ", ".join(f"{scan.count(status)} {name}" for name, status in others.items())
    blind = int(np.count_nonzero(~measured.any(axis=1)))
    yield (
        f"{len(measured)} frames, {measured.sum()} points, {measured.mean():.1%} of the scan lines; {told}; "
        f"{blind} frames measure nothing"
    )
    if scan.count(ScanStatus.TWO_STRIPES) > measured.sum():
        yield "WARNING: more scan lines show two stripes than one. Is the colour right, and the room dark enough?"
    if measured.any():
        yield (
            f"stripe of sigma {scan.stripe.sigma_px:.2f} px; noise moves a point by "
            f"{np.median(scan.deviation_m[measured]) * 1e3:.3f} mm (median of one sigma)"
        )


def _about_turns(scan: Scan, motion: Motion) -> Iterator[str]:
    apart_m = pass_disagreement(scan, motion)
    if np.isfinite(apart_m):
        much = apart_m > _SLIPPED * float(np.nanmedian(scan.deviation_m))
        yield f"later turns lie {apart_m * 1e3:.3f} mm from the first" + (
            ": more than noise explains. Is step_deg right, and did the object stay in its place?" if much else ""
        )


def _about_motion(check: MotionCheck) -> str:
    told = f"correlation {check.stated:.2f}, the other way {check.reversed:.2f}"
    if check.contradicted:
        return f"WARNING: the object's pattern moves the other way ({told}). The step's sign is wrong."
    if check.confirmed:
        return f"the object's pattern moves as stated ({told})"
    return "no pattern of the object could be followed from frame to frame: the direction of motion is not checked"


def _write(out: Path, draw: Callable[[Path], None], points_m: NDArray[np.float64], colours: Colours) -> Iterator[str]:
    """Picture and cloud, both or none."""
    cloud_first = out.suffix.lower() in CLOUDS
    picture, cloud = (".png", out.suffix) if cloud_first else (out.suffix, ".ply")
    with replaced(out) as part:
        draw(part.with_suffix(picture))
        written = write_point_cloud(part.with_suffix(cloud), points_m, colours)
    yield f"{out.with_suffix(picture)}: depth"
    yield f"{out.with_suffix(cloud)}: point cloud of {written} points, metres"
