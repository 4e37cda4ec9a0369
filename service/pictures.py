"""Arrays as pictures for people: frames, displacement maps, comparisons with the truth."""

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import zarr
from matplotlib.axes import Axes
from matplotlib.figure import Figure  # not pyplot, whose figures all threads share
from numpy.typing import NDArray
from PIL import Image

from processing.errors import ImageError
from processing.formats.raw import read_raw
from processing.laser.laser_chessboard import BoardStripe
from processing.products import LightStack, Mdf, NormalMap, ReflectanceMaps, StoredBtf
from processing.radiometry.display import srgb8
from processing.radiometry.mosaic import demosaic
from processing.radiometry.sensor_calibration import SensorCalibration

STILL = (".png", ".jpg", ".jpeg", ".tif", ".tiff")
BRIGHT_PERCENTILE = 99.5  # of a frame becomes white
MOST_PANELS = 8
PHASE_COLOURS = ("tab:red", "tab:green", "limegreen", "tab:blue")  # of the mosaic's 2 x 2 cell, red first


def check_still(path: Path) -> None:
    """Raises ImageError where the name is not that of a picture; before anything is computed for it."""
    if path.suffix.lower() not in STILL:
        raise ImageError(f"{path}: a picture is one of {', '.join(STILL)}.")


def frame_png(path: Path) -> bytes:
    """A frame as PNG bytes: a raw file in colour, of a burst the brightest moment of every pixel."""
    picture = _burst(path) if path.is_dir() else _raw(path)
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, "PNG")
    return buffer.getvalue()


def save_panels(path: Path, panels: Sequence[tuple[str, NDArray[np.floating]]], unit: str) -> None:
    """Maps (h, w) side by side with one common scale and a colour bar; NaN is grey."""
    values = np.concatenate([panel[np.isfinite(panel)] for _, panel in panels])
    low, high = np.percentile(values, (1, 99)) if values.size else (0.0, 1.0)
    figure = Figure(figsize=(3.6 * len(panels), 3.9), layout="constrained")
    axes = figure.subplots(1, len(panels), squeeze=False)
    for axis, (title, panel) in zip(axes[0], panels, strict=True):
        axis.set_facecolor("0.5")
        shown = axis.imshow(panel, vmin=low, vmax=high, cmap="magma_r", interpolation="nearest")
        axis.set_title(title, fontsize=10)
        axis.set_xticks([])
        axis.set_yticks([])
    figure.colorbar(shown, ax=axes, label=unit, shrink=0.8)
    figure.savefig(path, dpi=110)


def save_colour_panels(path: Path, panels: Sequence[tuple[str, NDArray[np.floating]]], columns: int) -> None:
    """Linear colour images (h, w, 3) side by side at one exposure (the 98th percentile of all becomes bright)."""
    values = np.concatenate([panel[np.isfinite(panel)] for _, panel in panels])
    peak = np.percentile(values, 98) if values.size else 1.0
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(2.6 * columns, 2.8 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    for axis in axes.flat:
        axis.axis("off")
    for axis, (title, panel) in zip(axes.flat, panels, strict=False):
        axis.imshow(np.clip(np.nan_to_num(panel) / max(peak, 1e-12), 0, 1) ** (1 / 2.2), interpolation="nearest")
        axis.set_title(title, fontsize=9)
    figure.savefig(path, dpi=110)


def draw_displacements(product: Path, out: Path) -> None:
    """Every view of an MDF, up to eight."""
    mdf = Mdf.load(product)
    views = [(f"view {i + 1}", view * 1e3) for i, view in enumerate(mdf.displacement_m[:MOST_PANELS])]
    save_panels(out, views, "mm along the view ray")


def draw_btf(product: Path, out: Path) -> None:
    """A BTF's steepest view under its lights, up to eight."""
    btf = StoredBtf.open(product)
    view = int(np.argmax(btf.view_directions[:, 2]))
    lights = range(min(btf.shape[0], MOST_PANELS))
    save_colour_panels(out, [(f"light {i + 1}", btf.image(i, view)) for i in lights], 4)


def draw_reflectance_maps(product: Path, out: Path) -> None:
    """A sphere's reflectance maps over gradient space, every light."""
    maps = ReflectanceMaps.load(product).reflectance_cos
    save_colour_panels(out, [(f"light {i + 1}", one) for i, one in enumerate(maps)], 4)


def draw_light_stack(product: Path, out: Path) -> None:
    """A body under its lights, up to eight of them spread over all."""
    pictures = LightStack.load(product).reflectance_cos
    chosen = np.unique(np.linspace(0, len(pictures) - 1, MOST_PANELS).round().astype(int))
    save_colour_panels(out, [(f"light {i + 1}", pictures[i]) for i in chosen], 4)


def draw_normals(product: Path, out: Path) -> None:
    """Normals as colours (red to the right, green up, blue toward the camera), albedo, and how sure the normals are."""
    normals = NormalMap.load(product)
    figure = Figure(figsize=(12, 4.4), layout="constrained")
    axes = figure.subplots(1, 3)
    coloured = np.where(normals.measured[..., None], (normals.normals + 1) / 2, 0)
    axes[0].imshow(coloured, interpolation="nearest")
    axes[1].imshow(np.clip(np.nan_to_num(normals.albedo), 0, 1) ** (1 / 2.2), interpolation="nearest")
    deviation_deg = np.degrees(np.sqrt(normals.variance))
    most_deg = float(np.nanpercentile(deviation_deg, 98)) if normals.measured.any() else 1.0
    shown = axes[2].imshow(deviation_deg, vmin=0, vmax=most_deg, cmap="viridis", interpolation="nearest")
    figure.colorbar(shown, ax=axes[2], shrink=0.8, label="deg")
    for axis, title in zip(axes, ("normals", "albedo", "standard deviation of the normals"), strict=True):
        axis.set(title=title, xticks=[], yticks=[])
    figure.savefig(out, dpi=110)


def draw_sensor(product: Path, out: Path) -> None:
    """A sensor as measured: photon transfer with its fit, residual from linearity, flat field, offsets."""
    measured = SensorCalibration.load(product)
    figure = Figure(figsize=(11, 8), layout="constrained")
    axes = figure.subplots(2, 2)
    _draw_transfer(axes[0, 0], measured)
    _draw_linearity(axes[0, 1], measured)
    correction = measured.correction
    flat = np.where(correction.hot, np.nan, correction.flat)
    low, high = np.nanpercentile(flat, (0.5, 99.5))
    shown = axes[1, 0].imshow(flat, vmin=low, vmax=high, cmap="gray", interpolation="nearest")
    axes[1, 0].set(title="flat field: lens and pixels, channels each with mean 1", xticks=[], yticks=[])
    figure.colorbar(shown, ax=axes[1, 0], shrink=0.8)
    axes[1, 1].hist(correction.offset_dn[~correction.hot], bins=120, log=True, color="C0")
    dark = measured.measurement.figures["dark_current_e_s"].value
    axes[1, 1].set(
        title=f"pixels in the dark; {correction.hot.sum()} hot, the others {dark:.2f} e-/s",
        xlabel="offset from the black level in dn", ylabel="pixels",
    )  # fmt: skip
    figure.suptitle(f"{measured.model} {measured.serial}, ISO {measured.iso:g}, {measured.date_utc}")
    figure.savefig(out, dpi=100)


def _draw_transfer(axis: Axes, measured: SensorCalibration) -> None:
    """Variance over signal, both in counts, with the fitted line."""
    levels, figures = measured.measurement.transfer, measured.measurement.figures
    order = np.argsort(levels.signal_dn)
    axis.plot(levels.signal_dn[order], levels.expected_dn2[order], "k-", lw=0.8, label="fit")
    for phase, colour in enumerate(PHASE_COLOURS):
        mine = (levels.phase == phase) & levels.used
        axis.plot(levels.signal_dn[mine], levels.variance_dn2[mine], "o", ms=4, color=colour)
        left = (levels.phase == phase) & ~levels.used
        axis.plot(levels.signal_dn[left], levels.variance_dn2[left], "x", ms=5, color=colour)
    gain, read = figures["gain_e_per_dn"], figures["read_noise_e"]
    axis.set(
        title=f"{gain.value:.4f} +- {gain.sigma:.4f} e-/dn, read noise {read.value:.3f} +- {read.sigma:.3f} e-",
        xlabel="linear signal in dn", ylabel="variance in dn2 (crosses: saturation, not fitted)",
        xscale="symlog", yscale="log",
    )  # fmt: skip
    axis.grid(alpha=0.3)


def _draw_linearity(axis: Axes, measured: SensorCalibration) -> None:
    """What is left of each level, and the curve that was taken out."""
    levels, linearity = measured.measurement.transfer, measured.measurement.linearity
    for phase, colour in enumerate(PHASE_COLOURS):
        mine = (levels.phase == phase) & np.isfinite(levels.residual)
        axis.plot(levels.signal_dn[mine], 100 * levels.residual[mine], "o", ms=4, color=colour)
    counted = np.linspace(1, linearity.span_dn, 200)
    axis.plot(
        counted, 100 * (counted / linearity.linear_dn(counted) - 1), "k-", lw=0.8, label="counts before correction"
    )
    axis.set(title="linearity: residual from an even growth", xlabel="linear signal in dn", ylabel="%")
    axis.legend()
    axis.grid(alpha=0.3)


def save_stripes(path: Path, stripes: Sequence[BoardStripe]) -> None:
    """Laser stripes of several images in one picture, coloured by their depth."""
    figure = Figure(figsize=(8, 5.4), layout="compressed")
    axis = figure.subplots()
    depth_m = np.concatenate([stripe.points_m[:, 2] for stripe in stripes])
    uv_px = np.concatenate([stripe.uv_px for stripe in stripes])
    shown = axis.scatter(uv_px[:, 0], uv_px[:, 1], c=depth_m, s=2, cmap="viridis_r")
    axis.set(aspect="equal", xlabel="column in px", ylabel="row in px", facecolor="0.1")
    axis.invert_yaxis()
    figure.colorbar(shown, label="depth in m")
    figure.savefig(path, dpi=110)


def _raw(path: Path) -> NDArray[np.uint8]:
    raw = read_raw(path)
    signal = raw.mosaic.astype(np.float32) - raw.sensor.black_dn
    colour, _ = demosaic(signal, np.ones_like(signal), raw.cfa)
    balanced = colour * raw.white_balance
    return srgb8(balanced / max(float(np.percentile(balanced, BRIGHT_PERCENTILE)), 1.0))


def _burst(path: Path) -> NDArray[np.uint8]:
    brightest = np.asarray(zarr.open_array(store=path, mode="r")[:]).max(axis=0).astype(np.float64)
    rows, columns = (side // 2 for side in brightest.shape)
    # Per cell of the mosaic: a red laser shows in one pixel of four.
    brightest = brightest[: 2 * rows, : 2 * columns].reshape(rows, 2, columns, 2).max(axis=(1, 3))
    low, high = np.percentile(brightest, (1, BRIGHT_PERCENTILE))
    return np.asarray(255 * np.clip((brightest - low) / max(high - low, 1.0), 0, 1), np.uint8)
