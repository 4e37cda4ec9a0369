"""A scene made of its file: meshes, reflectances and light, ready to be precomputed."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from math import radians
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from processing.environment.equirectangular import read_environment
from processing.errors import ProcessingError
from processing.geometry import rigid
from processing.lighting.brdfs import Brdf
from processing.lighting.outline import flat_outline
from processing.lighting.triangle_body import TriangleBody
from processing.products import Environment
from processing.products.arrays import Float64
from render.camera import Camera, look_at
from render.errors import RenderError
from render.mesh import Mesh
from render.mesh_file import load_mesh
from render.reshaping import scaled, subdivided
from render.scene import light
from render.shapes import box
from rig.errors import ConfigError
from service.relit_bodies import body_of
from service.relit_materials import material_brdf
from service.scene_file import BodyTable, CameraTable, PrecomputationTable, SceneFile, Vector, read_scene
from service.viewing import SHAPES

SHAPES_OF_SCENES = {"box": box, **SHAPES}
_CUBE_TEXELS = 128  # a degree or less: the light's sample directions are that far apart
_ROOM = 1.15  # around what is looked at


@dataclass(frozen=True)
class Orbit:
    """An eye that looks at `target_m`, from an azimuth counted from +X toward +Y and an elevation over the horizon."""

    target_m: Vector
    azimuth_rad: float
    elevation_rad: float
    distance_m: float
    field_of_view_rad: float

    def camera(self, size: tuple[int, int]) -> Camera:
        """The view in a window of `size` (width, height)."""
        target = np.array(self.target_m)
        eye = target + self.distance_m * light(self.azimuth_rad, self.elevation_rad).direction
        return look_at(eye, target, size, field_of_view_rad=self.field_of_view_rad)


@dataclass(frozen=True)
class Place:
    """Where a body stands: turned about x, then y, then z of the room, and put there."""

    place_m: Vector
    turn_rad: Vector

    @classmethod
    def of(cls, place_mm: Vector, turn_deg: Vector) -> "Place":
        """As people write it."""
        return cls(_in_metres(place_mm), _in_radians(turn_deg))

    @property
    def pose(self) -> Float64:
        """World from body (4, 4)."""
        turn = Rotation.from_euler("xyz", self.turn_rad).as_matrix()  # small letters: axes that stay
        return rigid(turn, self.place_m)


@dataclass(frozen=True, eq=False)
class SceneBody:
    """A mesh in its own frame, in metres, and as triangles that block light; whether it throws shadows on others; the
    name of its material."""

    name: str
    mesh: Mesh
    triangles: TriangleBody
    place: Place
    casts: bool
    material: str


@dataclass(frozen=True, eq=False)
class RelitScene:
    """All that a scene's file says, read and checked; the first environment and the bodies' materials are shown.

    With `background` the environment is seen behind the bodies. `doubts` are sentences about what could be better.
    """

    bodies: tuple[SceneBody, ...]
    materials: Mapping[str, Brdf]
    environments: Mapping[str, Environment]
    light_azimuth_rad: float
    orbit: Orbit
    stops: float
    background: bool
    precomputation: PrecomputationTable
    doubts: tuple[str, ...]


def open_scene(path: Path) -> RelitScene:
    """Read a scene's file and all that it names. Raises ConfigError that says which table is wrong, and why."""
    return made_scene(read_scene(path), path)


def made_scene(file: SceneFile, path: Path) -> RelitScene:
    """What a scene's file describes; `path` is the file's, and what its paths are relative to the folder of."""
    doubts: list[str] = []
    bodies = tuple(_body(table, path, doubts) for table in file.body)
    return RelitScene(
        bodies,
        _materials(file, path),
        _environments(file, path),
        radians(file.light_azimuth_deg),
        _orbit(file.camera, bodies),
        file.camera.stops,
        file.camera.background,
        file.precomputation,
        tuple(doubts),
    )


def _body(table: BodyTable, path: Path, doubts: list[str]) -> SceneBody:
    with _named(path, f"[[body]] {table.name!r}"):
        mesh = scaled(_mesh(table.mesh, path.parent), np.array(table.scale))
        if table.edge_mm is not None:
            mesh = subdivided(mesh, table.edge_mm / 1e3)
        triangles, faults = body_of(mesh)
    if table.casts and flat_outline(triangles) is None:  # a floor is open, and hides what it should
        doubts += [f"{table.name}: {fault}" for fault in faults]
    place = Place.of(table.place_mm, table.turn_deg)
    return SceneBody(table.name, mesh, triangles, place, table.casts, _material_name(table))


def _mesh(name: str, folder: Path) -> Mesh:
    if name in SHAPES_OF_SCENES:
        return SHAPES_OF_SCENES[name]()
    if not (folder / name).is_file():
        raise ConfigError(f"mesh {name!r} is no file beside the scene, and no shape: {', '.join(SHAPES_OF_SCENES)}")
    return load_mesh(folder / name)


def _material_name(table: BodyTable) -> str:
    return table.material if isinstance(table.material, str) else f"of {table.name}"


def _materials(file: SceneFile, path: Path) -> dict[str, Brdf]:
    found = {}
    for name, table in file.materials.items():
        with _named(path, f"[materials.{name}]"):
            found[name] = material_brdf(table, path.parent)
    for body in file.body:
        if not isinstance(body.material, str):
            with _named(path, f"[[body]] {body.name!r}, material"):
                found[_material_name(body)] = material_brdf(body.material, path.parent)
    return found


def _environments(file: SceneFile, path: Path) -> dict[str, Environment]:
    found: dict[str, Environment] = {}
    for name in (file.environment, *file.environments):
        with _named(path, f"environment {name!r}"):
            label = light_name(path.parent / name)
            if label in found:
                raise ConfigError(f"another environment is named {label!r} already; rename one")
            found[label] = read_light(path.parent / name)
    return found


def light_name(source: Path) -> str:
    """What people call it: the file or folder, or the session that captured it."""
    return source.parents[1].name if source.parent.name == "products" else source.stem


def read_light(source: Path) -> Environment:
    """Of the folder of a product, or of a panorama. Raises ImageError, ConfigError."""
    if source.is_dir():
        return Environment.load(source)
    if not source.is_file():
        raise ConfigError("no such file or folder: a panorama (.exr, .hdr), or what `rig environment` made")
    return read_environment(source, _CUBE_TEXELS)[0]


def _orbit(table: CameraTable, bodies: tuple[SceneBody, ...]) -> Orbit:
    shown = [body for body in bodies if flat_outline(body.triangles) is None] or list(bodies)
    points = np.concatenate([_in_world(body) for body in shown])
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    x, y, z = middle.tolist()
    target_m = (x, y, z) if table.target_mm is None else _in_metres(table.target_mm)
    field_rad = radians(table.field_of_view_deg)
    reach = float(np.linalg.norm(points - target_m, axis=1).max())
    distance_m = _ROOM * reach / np.sin(field_rad / 2) if table.distance_mm is None else table.distance_mm / 1e3
    return Orbit(target_m, radians(table.azimuth_deg), radians(table.elevation_deg), float(distance_m), field_rad)


def _in_world(body: SceneBody) -> Float64:
    pose = body.place.pose
    return np.asarray(body.mesh.positions @ pose[:3, :3].T + pose[:3, 3])


def _in_metres(vector_mm: Vector) -> Vector:
    x, y, z = vector_mm
    return x / 1e3, y / 1e3, z / 1e3


def _in_radians(vector_deg: Vector) -> Vector:
    x, y, z = vector_deg
    return radians(x), radians(y), radians(z)


@contextmanager
def _named(path: Path, table: str) -> Iterator[None]:
    """Errors in there name the file and the table."""
    try:
        yield
    except (ConfigError, ProcessingError, RenderError) as error:
        raise ConfigError(f"{path}: {table}: {error}") from error
