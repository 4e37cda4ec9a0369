"""What is drawn: meshes with materials, seen by a camera, lit from directions."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from render.arrays import Float64, Rows, unit
from render.camera import Camera, look_at
from render.errors import SceneError
from render.materials import Material
from render.mesh import Mesh


@dataclass(frozen=True, eq=False)
class Light:
    """A directional light.

    `direction` (3,) is the unit vector from the object toward the light, in the world frame; `irradiance` (3,) falls
    on a surface that faces it.
    """

    direction: Float64
    irradiance: Float64


def light(azimuth_rad: float, elevation_rad: float, irradiance: float | Sequence[float] = 1.0) -> Light:
    """A light at an azimuth from +X toward +Y and an elevation over the horizon.

    Raises SceneError for angles that are no numbers.
    """
    if not np.isfinite((azimuth_rad, elevation_rad)).all():
        raise SceneError(f"a light at azimuth {azimuth_rad} and elevation {elevation_rad} rad stands nowhere")
    cos_elevation = np.cos(elevation_rad)
    direction = [np.cos(azimuth_rad) * cos_elevation, np.sin(azimuth_rad) * cos_elevation, np.sin(elevation_rad)]
    return Light(np.array(direction), np.broadcast_to(np.asarray(irradiance, dtype=np.float64), 3))


@dataclass(frozen=True, eq=False)
class Body:
    """A mesh and what it is made of."""

    mesh: Mesh
    material: Material


@dataclass(frozen=True, eq=False)
class Scene:
    """Bodies, camera and at least one light.

    `ambient` (3,) is irradiance that reaches every point as if from straight above its surface, or, where it has a
    factored BTF, equally from everywhere; zero unless wanted.
    With `shadows` bodies keep light from each other and from themselves.
    Raises SceneError for no body and for no light.
    """

    bodies: tuple[Body, ...]
    camera: Camera
    lights: tuple[Light, ...]
    ambient: tuple[float, float, float] = (0.0, 0.0, 0.0)
    shadows: bool = False

    def __post_init__(self) -> None:
        if not self.bodies:
            raise SceneError("no body: nothing would be seen")
        if not self.lights:
            raise SceneError("no light: nothing would be seen")

    @classmethod
    def of(
        cls,
        mesh: Mesh,
        material: Material,
        camera: Camera,
        lights: tuple[Light, ...],
        ambient: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> "Scene":
        """A scene of one body."""
        return cls((Body(mesh, material),), camera, lights, ambient)

    @property
    def positions(self) -> Float64:
        """Vertices (n, 3) of all bodies in the world frame."""
        return np.concatenate([body.mesh.positions for body in self.bodies])


def framed(
    mesh: Mesh, size: tuple[int, int], *, azimuth_rad: float, elevation_rad: float, field_of_view_rad: float = 0.45
) -> Camera:
    """A camera that sees the mesh from a direction, in the middle of the window and as large as fits with a margin.

    `size` is (width, height). All vertices fall within 88 % of the window along each side.
    """
    direction = light(azimuth_rad, elevation_rad).direction
    up = (0.0, 1.0, 0.0) if abs(direction[2]) > 0.999 else (0.0, 0.0, 1.0)
    target = 0.5 * (mesh.positions.min(axis=0) + mesh.positions.max(axis=0))
    radius = float(np.linalg.norm(mesh.positions - target, axis=1).max())
    distance = 2.0 * radius / np.sin(0.5 * field_of_view_rad)
    for _ in range(8):
        camera = look_at(target + distance * direction, target, size, field_of_view_rad=field_of_view_rad, up=up)
        middle, share = _extent(camera, mesh.positions)
        # Both are exact for a far object; a near one is approached from farther away, step by step.
        target = target + distance * (middle @ camera.camera_from_world[:2, :3])
        distance = max(distance * share / 0.88, 1.05 * radius)
    return look_at(target + distance * direction, target, size, field_of_view_rad=field_of_view_rad, up=up)


def _extent(camera: Camera, positions: Rows) -> tuple[Float64, float]:
    """Middle (2,) of the points' image as slopes from the optical axis, and the share of the window that it spans."""
    points = camera.in_camera(positions)
    slope = points[:, :2] / points[:, 2:]
    low, high = slope.min(axis=0), slope.max(axis=0)
    window = np.array(camera.size) / camera.matrix[[0, 1], [0, 1]]
    return 0.5 * (low + high), float(((high - low) / window).max())


def orbiting_light(scene: Scene, frames: int, *, arc_rad: float = 2.0 * np.pi) -> Iterator[Scene]:
    """The scene once per frame while its first light turns about the world's Z axis.

    A full turn is a loop without a doubled frame; a smaller arc swings to and fro around the light's own azimuth,
    from its lower end.
    """
    turn = np.arange(frames) / frames
    angles_rad = arc_rad * turn if arc_rad >= 2.0 * np.pi else -0.5 * arc_rad * np.cos(2.0 * np.pi * turn)
    for angle_rad in angles_rad:
        yield replace(scene, lights=(_turned(scene.lights[0], angle_rad), *scene.lights[1:]))


def turning_lights(scene: Scene, frames: int) -> Iterator[Scene]:
    """The scene once per frame while all its lights together turn about the world's Z axis, all the way round."""
    for angle_rad in 2.0 * np.pi * np.arange(frames) / frames:
        yield replace(scene, lights=tuple(_turned(each, angle_rad) for each in scene.lights))


def _turned(each: Light, angle_rad: float) -> Light:
    """The light turned about the world's Z axis, from +X toward +Y."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    about_z = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return replace(each, direction=unit(about_z @ each.direction))
