"""Each material on the shapes that show it best, under a moving light, as files."""

from collections.abc import Sequence
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np

from processing.products import FactoredBtf, Mesostructure, SbrdfPlus, Srf
from render.errors import MaterialError
from render.materials import Material
from render.mesh import Mesh
from render.picture import contact_sheet, exposure_for, save_animation, save_image
from render.preview import Preview
from render.scene import Body, Scene, framed, light, orbiting_light
from render.shapes import captured_sphere, knot, plane, sphere, torus, vase
from render.srf import repeating

_SHEET_FRAMES, _SHEET_COLUMNS = 8, 4
_MOVING_SIDE_PX = 300


@dataclass(frozen=True)
class Gallery:
    """The files of one scene: a still, a contact sheet and an animation under the moving light; who drew them."""

    name: str
    renderer: str
    still: Path
    sheet: Path
    animation: Path


@dataclass(frozen=True)
class _Stand:
    """Where camera and light stand, in degrees; the light's azimuth counts from the camera's.

    An arc of 360 turns the light round, a smaller one swings it to and fro about its azimuth.
    """

    camera_azimuth_deg: float
    camera_elevation_deg: float
    light_azimuth_deg: float
    light_elevation_deg: float
    arc_deg: float


# The captured sphere is seen as the capture's camera saw it.
_CAPTURED = _Stand(0.0, 0.0, 0.0, 30.0, 110.0)
_STANDING = _Stand(-35.0, 18.0, 0.0, 35.0, 120.0)
_LYING = _Stand(-90.0, 58.0, 60.0, 35.0, 360.0)
_RING = _Stand(-35.0, 38.0, 120.0, 45.0, 360.0)


@dataclass(frozen=True)
class Show:
    """A scene and the arc over which its light moves; 2 pi is all the way round."""

    scene: Scene
    arc_rad: float

    def frames(self, count: int) -> list[Scene]:
        """The scene at `count` moments of the light's way, which closes to a loop."""
        return list(orbiting_light(self.scene, count, arc_rad=self.arc_rad))

    def sheet_frames(self, count: int) -> list[int]:
        """Frames of `count` that differ: all the way round, or one way of the swing."""
        way = count if self.arc_rad >= 2.0 * np.pi else count // 2 + 1
        return sorted({way * frame // _SHEET_FRAMES for frame in range(_SHEET_FRAMES)})


def scenes(material: Material, size: tuple[int, int]) -> dict[str, Show]:
    """Shows by name.

    An SRF is shown on a sphere and a vase, a BTF, factored or as SBRDF+, on a plane and a torus, and with its depths on
    a torus and a knot, which throw shadows. A sphere's map is shown on the sphere that it was taken from, and mirrored
    at its borders on the vase. Raises MaterialError for anything else.
    """
    if isinstance(material, Srf):
        ball = sphere() if material.wrap else captured_sphere()
        return {
            "srf_sphere": _show(ball, material, size, _STANDING if material.wrap else _CAPTURED),
            "srf_vase": _show(vase(), repeating(material), size, _STANDING),
        }
    if isinstance(material, FactoredBtf | SbrdfPlus):
        name = "btf" if isinstance(material, FactoredBtf) else "sbrdf"
        return {
            f"{name}_plane": _show(plane(tiles=(2.0, 2.0)), material, size, _LYING),
            f"{name}_torus": _show(torus(), material, size, _RING),
        }
    if isinstance(material, Mesostructure):
        return {
            "relief_torus": _show(torus(), material, size, _RING),
            "relief_knot": _show(knot(), material, size, _RING),
        }
    known = "Srf, FactoredBtf, SbrdfPlus and Mesostructure"
    raise MaterialError(f"{type(material).__name__}: the showcase has scenes for {known}")


def write_showcase(
    material: Material, folder: Path, *, size: tuple[int, int] = (600, 600), frames: int = 24
) -> tuple[Gallery, ...]:
    """Draw every scene of the material and write its pictures into `folder`, which is made.

    The animation and its contact sheet are at most 300 pixels high; all pictures of a scene share one exposure.
    """
    folder.mkdir(parents=True, exist_ok=True)
    shrunk = min(1.0, _MOVING_SIDE_PX / size[1])
    moving_size = (max(round(size[0] * shrunk), 1), max(round(size[1] * shrunk), 1))
    with Preview(size) as preview:
        return tuple(
            _write_show(preview, folder / name, show, show.frames(frames), (size, moving_size))
            for name, show in scenes(material, size).items()
        )


def _write_show(
    preview: Preview,
    stem: Path,
    show: Show,
    moving: Sequence[Scene],
    sizes: tuple[tuple[int, int], tuple[int, int]],
) -> Gallery:
    preview.resize(sizes[0])
    still = preview.draw(moving[0])
    preview.resize(sizes[1])
    pictures = preview.draw_all(moving)
    exposure = exposure_for(pictures)
    images = [picture.srgb8(exposure) for picture in pictures]
    files = (stem.with_name(f"{stem.name}{ending}") for ending in (".png", "_lights.png", "_lights.webp"))
    gallery = Gallery(stem.name, preview.renderer_name, *files)
    save_image(gallery.still, still.srgb8(exposure))
    save_image(gallery.sheet, contact_sheet([images[k] for k in show.sheet_frames(len(images))], _SHEET_COLUMNS))
    save_animation(gallery.animation, images)
    return gallery


def _show(mesh: Mesh, material: Material, size: tuple[int, int], stand: _Stand) -> Show:
    azimuth_rad, elevation_rad, light_azimuth_rad, light_elevation_rad, arc_rad = map(float, np.radians(astuple(stand)))
    camera = framed(mesh, size, azimuth_rad=azimuth_rad, elevation_rad=elevation_rad)
    key = light(azimuth_rad + light_azimuth_rad, light_elevation_rad)
    return Show(Scene((Body(mesh, material),), camera, (key,), shadows=isinstance(material, Mesostructure)), arc_rad)
