"""The mesostructure distance function from laser sweeps: peak times, planes, range images, merging, texels."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from processing import geometry
from processing.cameras.calibration import CameraModel
from processing.errors import ImageError
from processing.laser.displacement import Merged, merge_displacements, tetrahedron_weights
from processing.laser.fan import fan_source
from processing.laser.holder import Holder, reference_region, wanted_pixels
from processing.laser.laser_plane import LaserMount, LaserSweep, SweepStatus, sweep_planes
from processing.laser.range_image import RangeImage, RangeStatus, range_image
from processing.laser.space_time import PeakStatus, PeakTimes, PulseSettings, peak_times
from processing.laser.texel_range import pixel_extent, texel_displacement
from processing.products.mdf import Mdf
from processing.radiometry.sensor import Sensor

Array = NDArray[np.float64]
DIM = 0.03  # of the white frame's pulse: darker ones are interreflections, not the stripe
FALSE = 1 / 8  # of the box's depth: a displacement that is off by more is false
DOUBT = FALSE / 1.44  # of it: with a larger standard deviation more than one texel in seven would be false: a hole
ROUGHNESS_PX = 0.15  # locations light a pixel unevenly: anywhere in its middle half, on a slope of 45 degrees
_MERGED = ("displacement_m", "variance_m2", "used", "rejected")  # the images of Merged


class Weighting(Enum):
    """How laser locations are weighted when they are merged."""

    VARIANCE = "variance"  # inverse variances
    TETRAHEDRON = "tetrahedron"  # the paper's volumes


@dataclass(frozen=True)
class Sweep:
    """One passage of the stripe in one camera.

    `view` names what shares one view of the sample: camera and turntable angle. `frames` are uint16 mosaics (t, h, w)
    or any iterable of them; `times` (t,) in frame intervals where frames are missing or uneven. `unusable` (h, w) are
    pixels whose counts mean nothing, such as hot ones.
    """

    view: str
    frames: Iterable[NDArray[np.uint16]]
    sensor: Sensor
    camera: CameraModel
    rig_from_sample: Array
    mount: LaserMount
    times: Array | None = None
    unusable: NDArray[np.bool_] | None = None


@dataclass(frozen=True)
class SweepResult:
    """What one sweep gave: peak times (None once let go), laser planes, displacements."""

    sweep: Sweep
    peaks: PeakTimes | None
    laser: LaserSweep
    image: RangeImage

    @property
    def completeness(self) -> float:
        """Share of the pixels that look at the sample which were measured."""
        looking = self.image.status != RangeStatus.NOT_SAMPLE
        return float(np.mean(self.image.status[looking] == RangeStatus.MEASURED)) if looking.any() else 0.0


@dataclass(frozen=True)
class ViewResult:
    """The merged displacement of one view, the status of its sweeps' lasers, and each sweep's completeness."""

    view: str
    merged: Merged
    lasers: tuple[LaserSweep, ...]
    completeness: tuple[float, ...]


def mdf_from_sweeps(
    sweeps: Iterable[Sweep],
    holder: Holder,
    texels: int,
    weighting: Weighting = Weighting.VARIANCE,
    settings: PulseSettings | None = None,
    plane_m: float = 0.0,
) -> tuple[Mdf, tuple[ViewResult, ...]]:
    """MDF (view, y, x) over the holder's texels, and what became of each view, in the order in which views appear.

    The texels lie `plane_m` under the reference plane.

    Sweeps of one view follow one another. They are taken one by one, so frames may be read as they are needed, and no
    more than one view's sweeps are in memory. A view direction is that of the camera from the sample's centre, in the
    sample frame. Texels that no laser location reached are NaN.
    Raises ImageError where there is no sweep, a view's sweeps are torn apart, or frames do not fit their camera.
    """
    merged: dict[str, ViewResult] = {}
    sheets, eyes = [], []
    for view, mine in groupby(sweeps, key=lambda sweep: sweep.view):
        if view in merged:
            raise ImageError(f"{view}: its sweeps must follow one another, but those of another view lie between.")
        results = [_to_merge(measure_sweep(sweep, holder, settings)) for sweep in mine]
        merged[view] = merge_view(view, results, weighting)
        sheets.append(view_texels(merged[view].merged, results[0].sweep, holder, texels, plane_m))
        eyes.append(
            geometry.rotate(geometry.invert(results[0].sweep.rig_from_sample), results[0].sweep.camera.centre_m)
        )
    if not merged:
        raise ImageError("no sweeps: an MDF needs at least one view.")
    displacement, variance = (np.stack([sheet[i] for sheet in sheets]) for i in (0, 1))
    away_m = np.linalg.norm(eyes, axis=1)
    mdf = Mdf(
        displacement, variance, np.stack(eyes) / away_m[:, None], holder.texels_m, plane_m=plane_m, distances_m=away_m
    )
    return mdf, tuple(merged.values())


def _to_merge(result: SweepResult) -> SweepResult:
    """Without frames and peak times, so that a view's sweeps need 9 bytes per pixel each."""
    return replace(result, sweep=replace(result.sweep, frames=()), peaks=None)


def measure_sweep(sweep: Sweep, holder: Holder, settings: PulseSettings | None = None) -> SweepResult:
    """Peak times, laser planes and displacements of one sweep. Raises ImageError where frames do not fit the camera."""
    wanted = wanted_pixels(sweep.camera, sweep.rig_from_sample, holder, fan_source(sweep.mount.fan)[0])
    if sweep.unusable is not None:
        wanted &= ~sweep.unusable
    try:
        peaks = peak_times(sweep.frames, sweep.sensor, settings, sweep.times, wanted)
    except ImageError as error:
        raise ImageError(f"{sweep.view}, a camera of {sweep.camera.size} pixels: {error}") from error
    laser = sweep_planes(peaks, sweep.camera, sweep.rig_from_sample, holder, sweep.mount)
    if laser.status != SweepStatus.NO_STRIPE:
        peaks = _without_dim(peaks, sweep, holder, laser)
    return SweepResult(sweep, peaks, laser, range_image(peaks, sweep.camera, sweep.rig_from_sample, holder, laser))


def merge_view(view: str, results: Sequence[SweepResult], weighting: Weighting) -> ViewResult:
    """Merge the sweeps of one view over the laser's locations, where their pixels look at the sample."""
    camera, weights = results[0].sweep.camera, None
    if weighting == Weighting.TETRAHEDRON:
        weights = tetrahedron_weights(np.stack([r.laser.source_m for r in results]), camera.centre_m)
    looking = results[0].image.status != RangeStatus.NOT_SAMPLE
    displacement, variance = (
        np.stack([getattr(r.image, name)[looking] for r in results])[:, None] for name in _MERGED[:2]
    )
    merged = _spread(merge_displacements(displacement, variance, weights, ROUGHNESS_PX * _pixel_m(camera)), looking)
    return ViewResult(view, merged, tuple(r.laser for r in results), tuple(r.completeness for r in results))


def _pixel_m(camera: CameraModel) -> float:
    """Side of a pixel on the reference plane, in the middle of the sample."""
    pitch_m = 1e-3 * float(np.linalg.norm(camera.centre_m))
    return pixel_extent(camera.project(geometry.texel_grid(2, 2 * pitch_m)), pitch_m)


def _spread(merged: Merged, looking: NDArray[np.bool_]) -> Merged:
    """What was merged of some pixels, at their places in the image (h, w)."""
    images = {}
    for name in _MERGED:
        values = getattr(merged, name)[0]
        images[name] = np.full(looking.shape, np.nan if values.dtype.kind == "f" else 0, values.dtype)
        images[name][looking] = values
    return replace(merged, **images)


def view_texels(
    merged: Merged, sweep: Sweep, holder: Holder, texels: int, plane_m: float = 0.0
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Displacement and variance (n, n) of a view on the sample's texel grid (row 0 at +Y), at z = -plane_m.

    NaN also where the displacement's standard deviation exceeds DOUBT of the box's depth: whether the ray meets a
    brick's edge or the joint behind it is then open, and a guess would be a false point.
    """
    grid = geometry.transform_points(sweep.rig_from_sample, geometry.texel_grid(texels, holder.texels_m, -plane_m))
    uv_px = sweep.camera.project(grid)
    found, variance = texel_displacement(merged.displacement_m, merged.variance_m2, uv_px, holder.texels_m / texels)
    with np.errstate(invalid="ignore"):
        doubtful = variance > (DOUBT * holder.depth_m) ** 2
    return np.where(doubtful, np.float32(np.nan), found), np.where(doubtful, np.float32(np.nan), variance)


def _without_dim(peaks: PeakTimes, sweep: Sweep, holder: Holder, laser: LaserSweep) -> PeakTimes:
    """Peaks under DIM of the white frame's, per place in the 2x2 mosaic, made TOO_DARK."""
    white = reference_region(sweep.camera, sweep.rig_from_sample, holder, laser.source_m).height > 0
    white &= peaks.status == PeakStatus.OK
    status = peaks.status.copy()
    for place in ((0, 0), (0, 1), (1, 0), (1, 1)):
        cell = (slice(place[0], None, 2), slice(place[1], None, 2))
        if white[cell].any():
            floor_e = DIM * float(np.median(peaks.amplitude_e[cell][white[cell]]))
            dim = (status[cell] == PeakStatus.OK) & (peaks.amplitude_e[cell] < floor_e)
            status[cell][dim] = PeakStatus.TOO_DARK
    missing = status != PeakStatus.OK
    time, variance, width = (
        np.where(missing, np.float32(np.nan), values)
        for values in (peaks.time_frames, peaks.variance, peaks.width_frames)
    )
    return PeakTimes(time, variance, peaks.amplitude_e, status, width)
