"""Looking at products: a material on a shape, under a light that stands still or moves."""

import json
from collections.abc import Callable
from dataclasses import replace
from math import radians
from pathlib import Path

import numpy as np

from processing.environment.equirectangular import panorama_of
from processing.errors import ImageError
from processing.products import Environment, FactoredBtf, Mesostructure, SbrdfPlus, Srf
from render.environment import Environment as Panorama
from render.environment import median_cut
from render.environment_file import load_environment
from render.errors import SceneError
from render.materials import Material
from render.mesh import Mesh
from render.mesh_file import load_mesh
from render.picture import exposure_for, save_animation, save_image
from render.preview import Preview
from render.scene import Body, Light, Scene, framed, light, turning_lights
from render.shapes import captured_sphere, cylinder, knot, plane, sphere, statue, torus, vase
from render.showcase import write_showcase
from render.srf import repeating
from render.teapot import teapot
from render.wrapping import wrapping
from service.environment_pictures import draw_environment
from service.files import replaced
from service.pictures import (
    STILL,
    check_still,
    draw_btf,
    draw_displacements,
    draw_light_stack,
    draw_normals,
    draw_reflectance_maps,
    draw_sensor,
)

ANIMATED = (".webp", ".gif", ".apng")
FRAMES = 24
_FLOOR = 3.0  # side of a floor, in lengths of what stands on it
_AMBIENT = (0.1, 0.1, 0.1)  # in shadows a form is still to be seen
# Pictures under these lie within 3 % (rms, of the mean) of those under all pixels: `rig bench srf`.
ENVIRONMENT_LIGHTS = 64
SKIN_MESH = "mesh.glb"  # beside an SRF that was made for this mesh alone
SHAPES: dict[str, Callable[[], Mesh]] = {
    "sphere": sphere,
    "plane": plane,
    "torus": torus,
    "cylinder": cylinder,
    "knot": knot,
    "vase": vase,
    "statue": statue,
    "teapot": teapot,
}
MATERIALS: dict[str, Callable[[Path], Material]] = {
    "srf": Srf.load,
    "factored_btf": FactoredBtf.load,
    "sbrdf_plus": SbrdfPlus.load,
    "mesostructure": Mesostructure.load,
}
MAPS = {
    "mdf": draw_displacements,
    "btf": draw_btf,
    "reflectance_maps": draw_reflectance_maps,
    "light_stack": draw_light_stack,
    "normals": draw_normals,
    "sensor": draw_sensor,
    "environment": draw_environment,
}


def kind_of(folder: Path) -> str:
    """The kind of the product in a folder. Raises ImageError where there is none."""
    try:
        return str(json.loads((folder / "product.json").read_text(encoding="utf-8"))["kind"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ImageError(f"{folder}: not a product; `rig process SESSION` makes and names them.") from error


def load_material(folder: Path) -> Material:
    """The material in a product folder. Raises ImageError where there is something else."""
    kind = kind_of(folder)
    if kind not in MATERIALS:
        raise ImageError(f"{folder}: a {kind} cannot be drawn on a shape; {', '.join(MATERIALS)} can.")
    return MATERIALS[kind](folder)


def is_skin(folder: Path) -> bool:
    """Whether the product was made for one mesh, which lies beside it."""
    return (folder / SKIN_MESH).is_file()


def mesh_named(name: str) -> Mesh:
    """One of the meshes that need no file, or a mesh file. Raises MeshError where that cannot be read."""
    return SHAPES[name]() if name in SHAPES else load_mesh(Path(name))


def shown_on(product: Path, shape: str) -> tuple[Material, Mesh]:
    """The material of a product folder with its mesh: a skin's own, else that of `shape_for`.

    Raises ImageError where a skin is to be drawn on another mesh.
    """
    material = load_material(product)
    if not is_skin(product):
        return shape_for(material, shape)
    if shape:
        raise ImageError(f"{product}: a skin fits the mesh that it was made for; leave --shape out")
    return material, load_mesh(product / SKIN_MESH)


def shape_for(material: Material, name: str) -> tuple[Material, Mesh]:
    """A mesh by name or file, and the material as that mesh needs it; without a name what shows it best."""
    captured = isinstance(material, Srf) and not material.wrap
    if name in ("", "sphere"):
        if captured:
            return material, captured_sphere()
        return material, _showing(material) if name == "" else sphere()
    covering = repeating(material) if isinstance(material, Srf) else material
    return covering, mesh_named(name)


def _showing(material: Material) -> Mesh:
    """A plane shows all of a material but its silhouettes."""
    return torus() if isinstance(material, Mesostructure) else plane()


def lights_of(azimuth_deg: float, elevation_deg: float, environment: Path | None) -> tuple[Light, ...]:
    """One light; or those that stand for an environment whose middle lies at the azimuth.

    The environment is an equirectangular file, or the folder of a product. Raises SceneError, ImageError.
    """
    if environment is None:
        return (light(radians(azimuth_deg), radians(elevation_deg)),)
    azimuth_rad = radians(azimuth_deg)
    if not environment.is_dir():
        return median_cut(load_environment(environment, azimuth_rad=azimuth_rad), ENVIRONMENT_LIGHTS)
    product = Environment.load(environment)
    picture = np.asarray(panorama_of(product, 2 * product.size).picture, np.float32)
    return median_cut(Panorama(picture, azimuth_rad), ENVIRONMENT_LIGHTS)


def draw_product(
    product: Path, out: Path, shape: str, lights: tuple[Light, ...], size: int, *, floor: bool = False
) -> str:
    """Draw a product into `out` and return what was done.

    Of a material one picture, for .webp and .gif lights that go round, for a folder its showcase, which has a light of
    its own; of a BTF, MDF or reflectance maps what was measured. A `floor` of the material lies under the shape.
    """
    if not out.suffix:
        return _draw_showcase(product, out, lights, size)
    if (kind := kind_of(product)) in MAPS:
        check_still(out)
        with replaced(out) as part:
            MAPS[kind](product, part)
        return f"{out}: the {kind} as measured"
    ending = out.suffix.lower()
    if ending not in ANIMATED + STILL:
        raise ImageError(f"{out}: a picture is .png or .jpg, a moving light .webp or .gif; no suffix means a folder.")
    material, mesh = shown_on(product, shape)
    scene = _scene(material, mesh, lights, size, floor=floor)
    with Preview((size, size)) as preview, replaced(out) as part:
        if ending in ANIMATED:
            _draw_moving_light(preview, scene, part)
        else:
            picture = preview.draw(scene)
            save_image(part, picture.srgb8(exposure_for([picture])))
        return f"{out} (drawn by {preview.renderer_name})"


def _draw_showcase(product: Path, out: Path, lights: tuple[Light, ...], size: int) -> str:
    """Draw the material on all shapes that show it best."""
    if len(lights) > 1:
        raise SceneError(f"{out}: an environment lights a picture (.png) or a moving light (.webp), not a folder")
    if is_skin(product):
        raise ImageError(f"{out}: a skin is drawn on its mesh alone; name a picture (.png, .jpg, .webp or .gif)")
    galleries = write_showcase(load_material(product), out, size=(size, size))
    return f"{out}: {', '.join(gallery.name for gallery in galleries)} (drawn by {galleries[0].renderer})"


def _scene(material: Material, mesh: Mesh, lights: tuple[Light, ...], size: int, *, floor: bool) -> Scene:
    """The mesh framed, seen from where its captured side or its top shows; what has depth throws shadows."""
    if mesh.map_from_world is not None:
        azimuth_deg, elevation_deg = 0.0, 0.0  # where the camera of the capture stood
    else:
        azimuth_deg, elevation_deg = -35.0, 38.0
    camera = framed(mesh, (size, size), azimuth_rad=radians(azimuth_deg), elevation_rad=radians(elevation_deg))
    if not floor and not isinstance(material, Mesostructure):
        return Scene.of(mesh, material, camera, lights)
    bodies = (Body(mesh, material), *([Body(_floor(mesh), material)] if floor else []))
    return Scene(bodies, camera, lights, ambient=_AMBIENT, shadows=True)


def _floor(mesh: Mesh) -> Mesh:
    """A plane under the mesh, with tiles as long as the mesh's own."""
    low, high = mesh.positions.min(axis=0), mesh.positions.max(axis=0)
    side = _FLOOR * float((high - low).max())
    tiles = side / float(np.exp(np.log(wrapping(mesh).stretch).mean()))
    level = plane(side, tiles=(tiles, tiles))
    return replace(level, positions=level.positions + np.append((low + high)[:2] / 2, low[2]))


def _draw_moving_light(preview: Preview, scene: Scene, out: Path) -> None:
    """Animate the scene while its lights go round the vertical."""
    pictures = preview.draw_all(turning_lights(scene, FRAMES))
    exposure = exposure_for(pictures)
    save_animation(out, [picture.srgb8(exposure) for picture in pictures])
