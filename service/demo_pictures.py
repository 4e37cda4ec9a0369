"""The pictures of the demo's report."""

from dataclasses import dataclass
from math import radians
from pathlib import Path

import numpy as np

from processing.products import Btf, FactoredBtf, Srf
from render.comparison import gl_vs_reference
from render.errors import GlUnavailableError
from render.materials import Material
from render.preview import Preview
from render.scene import Scene, light
from rig.sessions import Session
from service.pictures import frame_png, save_colour_panels, save_panels
from service.report import Picture
from service.truth import BtfErrors, MdfErrors, SrfErrors
from service.viewing import draw_moving_light, draw_sheet, scene_of, shape_for

SIZE_PX = 360
SHEET_AZIMUTHS_DEG = (-55.0, -20.0, 20.0, 55.0)


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
        record = records[len(records) // 2]
        path = session.folder.parent / f"frame-{kind}.png"
        path.write_bytes(frame_png(record.path))
        pictures.append(Picture(path, f"{kind}: {record.camera}, step {record.step.id}"))
    return tuple(pictures)


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
    """Every material on its shapes: a still sheet and a moving light each."""
    wanted: tuple[tuple[str, Material, str, str], ...] = (
        ("srf-sphere", srf, "sphere", "The stone's SRF on the sphere"),
        ("srf-vase", srf, "vase", "The stone's SRF on a vase"),
        ("btf-plane", factored, "plane", "The brick's BTF on a plane"),
        ("btf-torus", factored, "torus", "The brick's BTF on a torus"),
    )
    pictures, differences = [], []
    with Preview((SIZE_PX, SIZE_PX)) as preview:
        for name, material, shape, caption in wanted:
            shown, mesh = shape_for(material, shape)
            scene = scene_of(shown, mesh, (40.0, 40.0), SIZE_PX)
            pictures += _both(preview, scene, out, name, caption)
            try:
                differences.append(gl_vs_reference(shown, mesh))
            except GlUnavailableError:
                continue
        return Previews(tuple(pictures), preview.renderer_name, max(differences) if differences else None)


def _both(preview: Preview, scene: Scene, out: Path, name: str, caption: str) -> list[Picture]:
    sheet, moving = out / f"{name}.png", out / f"{name}-moving-light.webp"
    lit = [_under(scene, azimuth_deg) for azimuth_deg in SHEET_AZIMUTHS_DEG]
    draw_sheet(preview, lit, sheet)
    draw_moving_light(preview, lit[1], moving, arc_deg=140.0)
    return [Picture(sheet, f"{caption}, four lights"), Picture(moving, f"{caption}, moving light")]


def _under(scene: Scene, azimuth_deg: float) -> Scene:
    elevation_deg = 15.0 if scene.mesh.map_from_world is not None else 40.0
    lamp = light(radians(azimuth_deg), radians(elevation_deg))
    return Scene(scene.mesh, scene.material, scene.camera, (lamp,))
