"""The scenes in the rig: what a ray from anywhere in the rig hits, and which light falls on it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from simulators.layout import Array, HolderLayout, Layout, build_layout, rotation, transform
from simulators.light import radiance
from simulators.pose import Pose
from simulators.samples.brick import brick_relief
from simulators.samples.grass import grass_mesh
from simulators.samples.mesh import Mesh, MeshSample
from simulators.samples.peanut import peanut_mesh
from simulators.samples.pipe import pipe_mesh
from simulators.samples.relief import Relief, ReliefSample, flat_relief
from simulators.samples.spheres import SPHERES, Surface
from simulators.samples.weave import weave_mesh
from simulators.scene import Floats, Hits, Mask, Scene
from simulators.scene_board import BoardScene
from simulators.scene_figure import FigureScene
from simulators.scene_holder import HolderScene
from simulators.scene_mirror import MirrorScene
from simulators.scene_sphere import SphereScene
from simulators.sensor import Sensor, Unit, build_unit

CAP, LIGHTBOX = "cap", "lightbox"  # stand before every lens: no light at all, or an even diffuse field
UNTURNED = (*SPHERES, "figure")  # stand in the rig and not on the turntable
FLOOR_ALBEDO = 0.03  # of the empty opening's bottom


def _in_holder(relief: Callable[[Layout], Relief]) -> Callable[[Layout], Scene]:
    """Builds the scene of a height field in the holder."""
    return lambda layout: HolderScene(layout.holder, ReliefSample(relief(layout)))


def _mesh_in_holder(mesh: Callable[[HolderLayout, int], Mesh]) -> Callable[[Layout], Scene]:
    """Builds the scene of bodies in the holder, which are periodic over the part of the opening that is measured."""
    return lambda layout: HolderScene(layout.holder, MeshSample(mesh(layout.holder, layout.seed)))


def _sphere(surface: Surface) -> Callable[[Layout], Scene]:
    """Builds the scene of a sphere of this surface."""
    return lambda layout: SphereScene(layout.sphere, layout.seed, surface)


SCENES: Mapping[str, Callable[[Layout], Scene]] = {
    "none": _in_holder(lambda layout: flat_relief(layout.holder.opening_m, -layout.holder.depth_m, FLOOR_ALBEDO)),
    "white": _in_holder(lambda layout: flat_relief(layout.holder.opening_m, 0.0, layout.holder.albedo)),
    "brick": _in_holder(lambda layout: brick_relief(layout.holder.opening_m, layout.seed)),
    "weave": _mesh_in_holder(weave_mesh),
    "peanut": _mesh_in_holder(peanut_mesh),
    "grass": _mesh_in_holder(grass_mesh),
    "pipe": _mesh_in_holder(pipe_mesh),
    **{name: _sphere(surface) for name, surface in SPHERES.items()},
    "figure": lambda layout: FigureScene(layout.sphere, layout.seed),
    "charuco": lambda layout: BoardScene(layout.board),
    "mirror": lambda layout: MirrorScene(layout.mirror),
}


@dataclass(frozen=True)
class Lamp:
    """A lit lamp: position (3,), rig frame, and how strong it is per channel (3,) at the distance `reach_m`."""

    position_m: Array
    reach_m: float
    strength: Array


class Studio:
    """Layout and scenes of one rig; scenes are built when first seen."""

    def __init__(self, seed: int, size: str) -> None:
        self.seed = seed
        self.layout: Layout = build_layout(seed, size)
        self._sensors: dict[str, Unit] = {}
        self._scenes: dict[tuple[str, float], Scene] = {}

    def sensor(self, camera: str) -> Unit:
        """The camera's own sensor; it belongs to the seed and the serial number."""
        if camera not in self._sensors:
            device = self.layout.cameras[camera]
            key = (self.seed, device.serial, "sensor")
            self._sensors[camera] = build_unit(Sensor(), (device.height_px, device.width_px), key)
        return self._sensors[camera]

    def scene(self, sample: str, card_elevation_rad: float = 0.0) -> Scene:
        """The scene of a sample, its card toward this elevation. Raises ValueError where there is none of this name."""
        if sample not in SCENES:
            raise ValueError(f"no sample {sample!r}: one of {', '.join(SCENES)}")
        key = (sample, card_elevation_rad)
        if key not in self._scenes:
            facing = replace(self.layout, sphere=self.layout.sphere.facing(card_elevation_rad))
            self._scenes[key] = SCENES[sample](facing)
        return self._scenes[key]

    def rig_from_scene(self, pose: Pose) -> Array:
        """Rigid transform (4, 4): all but spheres and figure stand on the turntable, the board tilted by hand."""
        if pose.sample in UNTURNED:
            return np.eye(4)
        turned = transform(rotation(np.array([0.0, 0.0, pose.turntable_rad])), np.zeros(3))
        if pose.sample == "charuco":
            moved: Array = turned @ self.layout.rig_from_board(pose.board_pose)
            return moved
        return turned

    def to_scene(self, pose: Pose, points_m: Array) -> Array:
        """Points (..., 3) of the rig frame in the scene's frame."""
        rig_from_scene = self.rig_from_scene(pose)
        moved: Array = (points_m - rig_from_scene[:3, 3]) @ rig_from_scene[:3, :3]
        return moved

    def to_rig(self, pose: Pose, points_m: Array) -> Array:
        """Points (..., 3) of the scene's frame in the rig frame."""
        rig_from_scene = self.rig_from_scene(pose)
        moved: Array = points_m @ rig_from_scene[:3, :3].T + rig_from_scene[:3, 3]
        return moved

    def trace(self, pose: Pose, origin_m: Array, directions: Array) -> Hits:
        """First hits, in the scene's frame, of rays (n, 3) of the rig frame from one origin (3,)."""
        turned = directions @ self.rig_from_scene(pose)[:3, :3]
        return self._at(pose).trace(self.to_scene(pose, origin_m), turned)

    def lit(self, pose: Pose, hits: Hits, source_m: Array) -> Mask:
        """Which hits (n,) see the source (3,), rig frame."""
        return self._at(pose).lit(hits, self.to_scene(pose, source_m))

    def _at(self, pose: Pose) -> Scene:
        return self.scene(pose.sample, pose.card_elevation_rad)

    def lamp(self, pose: Pose, name: str, level: float = 1.0) -> Lamp:
        """A lamp where it stands in this pose."""
        position_m = self.layout.lamp_position(name, pose.light_arc_rad, pose.arm_rad)
        lamp = self.layout.lamps[name]
        return Lamp(position_m, lamp.distance_m, level * np.array(lamp.gains))

    def lamp_radiance(self, pose: Pose, hits: Hits, lamp: Lamp, eye_m: Array) -> Floats:
        """Radiance (n, 3) of the hits under one lamp toward an eye (3,), rig frame; shadows included."""
        source, eye = self.to_scene(pose, lamp.position_m), self.to_scene(pose, eye_m)
        return radiance(hits, self.lit(pose, hits, lamp.position_m), source, eye, lamp.reach_m) * np.float32(
            lamp.strength
        )
