"""The pictures of the demo's report."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from processing.products import Btf, FactoredBtf, Srf
from render.comparison import gl_vs_reference
from render.errors import GlUnavailableError
from render.showcase import Gallery, scenes, write_showcase
from rig.sessions import Session
from service.pictures import frame_png, save_colour_panels, save_panels
from service.pipeline.calibration import NETWORK, RESIDUALS
from service.pipeline.calibrations import CALIBRATION
from service.report import Picture
from service.truth import BtfErrors, MdfErrors, SrfErrors

SIZE_PX = 480
CAPTIONS = {
    "srf_sphere": "The stone's SRF on the sphere it was taken from",
    "srf_vase": "The stone's SRF on a vase",
    "btf_plane": "The brick's BTF on a plane",
    "btf_torus": "The brick's BTF on a torus",
}


@dataclass(frozen=True)
class Previews:
    """What was drawn by what, and how far the shaders are from the reference (None without OpenGL)."""

    pictures: tuple[Picture, ...]
    renderer: str
    difference: float | None


def frames(sessions: dict[str, Session]) -> tuple[Picture, ...]:
    """One frame of every session, as the camera delivered it."""
    pictures = []
    for kind, session in sessions.items():
        records = session.frames()
        shortest_s = min(record.exposure_s for record in records)
        unsaturated = [record for record in records if record.exposure_s == shortest_s]
        record = unsaturated[len(unsaturated) // 2]
        path = session.folder.parent / f"frame-{kind}.png"
        path.write_bytes(frame_png(record.path))
        pictures.append(Picture(path, f"{kind}: {record.camera}, step {record.step.id}"))
    return tuple(pictures)


def calibration(session: Session) -> tuple[Picture, ...]:
    """The pictures of the calibration's own product."""
    folder = session.products / CALIBRATION
    return (
        Picture(folder / NETWORK, "Cameras, boards and the turntable's axis, from above and from the side"),
        Picture(folder / RESIDUALS, "Corners: predicted less found, all cameras enlarged alike"),
    )


def srf(out: Path, errors: SrfErrors) -> tuple[Picture, ...]:
    """Truth, lobe alone and SRF side by side under one light of each side."""
    path = out / "srf-reconstruction.png"
    panels = []
    for light_number in (len(errors.truth) // 4, 3 * len(errors.truth) // 4):
        panels += [
            ("truth", errors.truth[light_number]),
            ("one Blinn-Phong lobe", errors.lobe[light_number]),
            ("SRF", errors.reconstruction[light_number]),
        ]
    save_colour_panels(path, panels, 3)
    return (Picture(path, "Reflectance maps over gradient space: truth, the lobe alone, the SRF"),)


def btf(out: Path, btf: Btf, errors: BtfErrors) -> tuple[Picture, ...]:
    """The brick in the steepest and the flattest view under four lights, truth above measurement."""
    path = out / "btf-images.png"
    elevation = btf.view_directions[:, 2]
    lights = np.linspace(0, len(btf.light_directions) - 1, 4).astype(int)
    panels = []
    for name, view in (("top view", int(np.argmax(elevation))), ("slanted view", int(np.argmin(elevation)))):
        panels += [(f"truth, {name}", errors.truth[number, view]) for number in lights]
        panels += [(f"measured, {name}", btf.reflectance[number, view]) for number in lights]
    save_colour_panels(path, panels, len(lights))
    return (Picture(path, "BTF of the brick: truth and measurement under four lights"),)


def mdf(out: Path, errors: MdfErrors) -> tuple[Picture, ...]:
    """Displacement of the first view: truth, measurement, difference."""
    maps, difference = out / "displacement.png", out / "displacement-error.png"
    panels = [("truth", errors.truth_m[0] * 1e3), ("measured", errors.measured_m[0] * 1e3)]
    save_panels(maps, panels, "mm along the view ray")
    off_um = [(f"view {i + 1}", (errors.measured_m[i] - errors.truth_m[i]) * 1e6) for i in range(len(errors.truth_m))]
    save_panels(difference, off_um[:4], "error in micrometres")
    return (
        Picture(maps, "Displacement of the brick in the first view; grey: not measured"),
        Picture(difference, "Measured less true displacement, one panel a view"),
    )


def previews(out: Path, srf: Srf, factored: FactoredBtf) -> Previews:
    """Every material on its shapes, a still and a moving light each."""
    size = (SIZE_PX, SIZE_PX)
    galleries = [*write_showcase(srf, out, size=size), *write_showcase(factored, out, size=size)]
    pictures = [picture for gallery in galleries for picture in _of_gallery(gallery)]
    shows = {**scenes(srf, size), **scenes(factored, size)}.values()
    try:
        difference = max(gl_vs_reference(body.material, body.mesh) for show in shows for body in show.scene.bodies)
    except GlUnavailableError:
        difference = None
    return Previews(tuple(pictures), galleries[0].renderer, difference)


def _of_gallery(gallery: Gallery) -> tuple[Picture, Picture]:
    what = CAPTIONS[gallery.name]
    return Picture(gallery.still, what), Picture(gallery.animation, f"{what}, under moving light")
