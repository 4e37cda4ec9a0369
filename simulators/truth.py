"""Ground truth, written beside the sessions for tests and benchmarks; never read by what is being tested."""

import hashlib
import inspect
import json
from collections.abc import Callable
from dataclasses import asdict
from math import degrees, radians
from pathlib import Path
from typing import Any

import numpy as np

from simulators.layout import PHONE, Array, CameraLayout
from simulators.lens import project, rays, sample_points, vignette
from simulators.light import CHANNELS, ELECTRONS_PER_RADIANCE
from simulators.phone import Phone
from simulators.pose import Pose
from simulators.scene import Floats, Hits
from simulators.scene_figure import FigureScene
from simulators.scene_sphere import SphereScene
from simulators.sphere_truth import maps_of
from simulators.studio import Lamp, Studio

REFLECTS = 0.1  # share of the scene that a reflection hides where it counts as one
Argument = str | int | list[tuple[str, float]]  # of a kind of truth, as the control port hands it on


class Truth:
    """Writes what the simulators know into a folder.

    `rate(camera, pose)` gives the noise-free mosaic. Arrays are .npy, records .json; names depend on the rig, the pose
    and the arguments alone. The mosaic of many exposures is written once.
    """

    def __init__(self, folder: Path, studio: Studio, rate: Callable[[str, Pose], Floats], phone: Phone) -> None:
        self._folder = folder
        self._studio = studio
        self._rate = rate
        self._phone = phone
        self._mosaics: set[Path] = set()

    def note_frame(self, unique_id: str, camera: str, pose: Pose, *, exposure_s: float, time_s: float) -> None:
        """Append one exposure to frames.jsonl: with its noise-free mosaic, or its laser planes if the laser shone.

        The phone's photographs have neither; see `environment`.
        """
        bare = pose.laser_on or camera == PHONE
        line = {
            "id": unique_id,
            "camera": camera,
            "time_s": time_s,
            "axes_deg": {
                "turntable": degrees(pose.turntable_rad),
                "light_arc": degrees(pose.light_arc_rad),
                "arm": degrees(pose.arm_rad),
            },
            "lamps": dict(pose.lamps),
            "laser": self._laser(pose),
            "sample": pose.sample,
            "board_pose": pose.board_pose,
            "place": pose.place,
            "facing": pose.facing,
            "exposure_s": exposure_s,
            "radiance": None if bare else str(self._mosaic(camera, pose).relative_to(self._folder)),
        }
        self._folder.mkdir(parents=True, exist_ok=True)
        with (self._folder / "frames.jsonl").open("a", encoding="utf-8") as frames:
            frames.write(json.dumps(line) + "\n")

    def tell(self, what: str, pose: Pose, **arguments: Argument) -> dict[str, Any]:
        """Write one kind of truth at a pose; returns {"path": ...} and what else the kind's own method names.

        `what`: displacement, points, normals, radiance, cameras, lamps, laser, board, srf, btf, sensor, environment.
        Raises ValueError for another.
        """
        tellers: dict[str, Callable[..., dict[str, Any]]] = {
            "displacement": self.displacement,
            "points": self.points,
            "normals": self.normals,
            "radiance": self.radiance,
            "cameras": self.cameras,
            "lamps": self.lamps,
            "laser": self.laser,
            "board": self.board,
            "srf": self.srf,
            "btf": self.btf,
            "sensor": self.sensor,
            "environment": self.environment,
        }
        if what not in tellers:
            raise ValueError(f"no truth named {what!r}: one of {', '.join(tellers)}")
        try:
            inspect.signature(tellers[what]).bind(pose, **arguments)
        except TypeError as error:
            raise ValueError(f"truth {what!r}: {error}") from error
        return tellers[what](pose, **arguments)

    def displacement(self, pose: Pose, camera: str, texels: int, depth_m: float = 0.0) -> dict[str, Any]:
        """Displacement (texels, texels) in metres along the view rays through the texel centres, NaN where none hits.

        The texels lie depth_m under z = 0. From the point where the ray of the camera's true place crosses z = 0 to the
        first hit. "lit_path": which of the hits (texels, texels) the laser, as mounted and standing in this pose, can
        reach; "points_path": the hits (texels, texels, 3), rig frame.
        """
        eye_m = self._camera(camera).rig_from_camera[:3, 3]
        below = self._studio.to_rig(pose, self._texels(texels, 1) - [0.0, 0.0, depth_m])
        entries = eye_m + (below - eye_m) * (eye_m[2] / (eye_m[2] + depth_m))
        hits = self._toward(pose, eye_m, below)
        points = np.full((texels**2, 3), np.nan)
        points[hits.ray] = self._studio.to_rig(pose, hits.points)
        lit = np.zeros(texels**2, bool)
        source = self._studio.layout.laser.source(pose.light_arc_rad, pose.laser_elevation_rad)
        lit[hits.ray] = self._studio.lit(pose, hits, source)
        depth = np.linalg.norm(points - entries, axis=1).reshape(texels, texels)
        key = (camera, texels, depth_m)
        return {
            "path": self._save("displacement", pose, key, depth),
            "lit_path": self._save("lit", pose, key, lit.reshape(texels, texels)),
            "points_path": self._save("texel-points", pose, key, points.reshape(texels, texels, 3)),
        }

    def points(self, pose: Pose, camera: str) -> dict[str, Any]:
        """First hits (h, w, 3) of the pixels' rays, rig frame, metres; NaN where a pixel sees nothing."""
        device = self._camera(camera)
        eye_m = device.rig_from_camera[:3, 3]
        hits = self._studio.trace(pose, eye_m, rays(device, sample_points(device, 1)))
        points = np.full((device.height_px * device.width_px, 3), np.nan)
        points[hits.ray] = self._studio.to_rig(pose, hits.points)
        return {"path": self._save("points", pose, camera, points.reshape(device.height_px, device.width_px, 3))}

    def radiance(self, pose: Pose, camera: str) -> dict[str, Any]:
        """The noise-free mosaic (h, w), electrons per second, under the lamps that shine."""
        return {"path": str(self._mosaic(camera, pose))}

    def cameras(self, pose: Pose) -> dict[str, Any]:
        """True optics of every camera: matrix, distortion (k1, k2), rig_from_camera, size."""
        record = {
            name: {
                "matrix": camera.matrix.tolist(),
                "distortion": list(camera.distortion),
                "rig_from_camera": camera.rig_from_camera.tolist(),
                "width_px": camera.width_px,
                "height_px": camera.height_px,
            }
            for name, camera in self._studio.layout.cameras.items()
        }
        return {"path": self._write("cameras", None, record), "cameras": record}

    def sensor(self, pose: Pose, camera: str) -> dict[str, Any]:
        """True numbers of a camera's own sensor, and its maps (h, w).

        "offset_path": above the black level, dn; "dark_path": dark current, e-/s; "response_path": the pixels' own
        response; "flat_path": that times the lens's vignetting.
        """
        device, unit = self._camera(camera), self._studio.sensor(camera)
        record = {"serial": device.serial, **asdict(unit.sensor), "hot_e_s": list(unit.sensor.hot_e_s)}
        return {
            "path": self._write(f"sensor-{camera}", None, record),
            "sensor": record,
            "offset_path": self._save("sensor-offset", None, camera, unit.offset_dn),
            "dark_path": self._save("sensor-dark", None, camera, unit.dark_e_s),
            "response_path": self._save("sensor-response", None, camera, unit.response),
            "flat_path": self._save("sensor-flat", None, camera, unit.response * vignette(device)),
        }

    def environment(self, pose: Pose) -> dict[str, Any]:
        """The light of the place where the phone is held: an equirectangular picture (h, 2 h, 3), see `places`.

        "mask_path": which pixels (h, w) of a photograph the frame's reflections hide. "rig_from_camera" (3, 3) by where
        the phone looks. "unit" and "unit_raw" (3,): the radiance that is 1 in a JPEG's unit (code 128 within 1 s at f/1
        and ISO 100) and in that of a raw file (an electron per second).
        """
        layout = self._phone.layout
        return {
            "path": self._save("environment", None, pose.place, self._phone.place(pose.place)),
            "mask_path": self._save("reflections", None, PHONE, layout.frame.hidden(layout.lens)[0] > REFLECTS),
            "rig_from_camera": {name: turn.tolist() for name, turn in layout.rig_from_camera.items()},
            "unit": self._phone.unit_of_jpeg().tolist(),
            "unit_raw": self._phone.unit_of_raw().tolist(),
        }

    def lamps(self, pose: Pose) -> dict[str, Any]:
        """True position (m, rig frame) of every lamp in this pose.

        "intensity_e_s" (red, green, blue) is what a pixel counts per second of a perfect white diffuser that faces the
        lamp at full level from 1 m, "level" how bright it now is.
        """
        record = {
            name: {
                "position_m": self._studio.lamp(pose, name).position_m.tolist(),
                "level": dict(pose.lamps).get(name, 0.0),
                "intensity_e_s": (ELECTRONS_PER_RADIANCE / np.pi * CHANNELS * lamp.distance_m**2 * lamp.gains).tolist(),
            }
            for name, lamp in self._studio.layout.lamps.items()
        }
        return {"path": self._write("lamps", pose, record), "lamps": record}

    def laser(self, pose: Pose) -> dict[str, Any]:
        """True source (m, rig frame), width, and the planes at the exposure's start and end where the laser shines."""
        record = self._laser(pose) | {"sigma_m": self._studio.layout.laser.sigma_m}
        return {"path": self._write("laser", pose, record), "laser": record}

    def board(self, pose: Pose) -> dict[str, Any]:
        """True rig_from_board of the ChArUco board in this pose."""
        record = {"rig_from_board": self._studio.rig_from_scene(pose).tolist()}
        return {"path": self._write("board", pose, record), "board": record}

    def srf(
        self,
        pose: Pose,
        lights: list[tuple[str, float]],
        camera: str = "front",
        size: int = 256,
        sample: str = "sphere",
    ) -> dict[str, Any]:
        """True reflectance maps R(p, q) (light, q, p, 3) of a sphere; see `sphere_truth.maps_of`.

        `lights` are lamps, each with the angle in degrees of the axis that carries it. The maps' axes are the camera's,
        turned toward the sphere. "centre_px" and "radius_px" are the circle through the sphere's limb in the image.
        """
        device, scene = self._camera(camera), self._studio.scene(sample, pose.card_elevation_rad)
        if not isinstance(scene, SphereScene):
            raise ValueError(f"truth 'srf': {sample!r} is no sphere")
        places = [self._studio.layout.lamp_position(name, radians(angle), radians(angle)) for name, angle in lights]
        axes = _turned_to_origin(device.rig_from_camera)
        maps = maps_of(scene, places, device.rig_from_camera[:3, 3], axes, size)
        centre_px, radius_px = limb_circle(device, scene.layout.radius_m)
        path = self._save("srf", None, (camera, repr(lights), size, sample, pose.card_elevation_rad), maps)
        return {"path": path, "centre_px": centre_px.tolist(), "radius_px": radius_px}

    def normals(self, pose: Pose, camera: str) -> dict[str, Any]:
        """Normals (h, w, 3) of a sphere or the figure where the pixels' rays first hit it, NaN where none does.

        In the camera's axes, but y up the picture and z toward the camera. They hold the material's bumps.
        """
        device, scene = self._camera(camera), self._studio.scene(pose.sample, pose.card_elevation_rad)
        if not isinstance(scene, SphereScene | FigureScene):
            raise ValueError(f"truth 'normals': {pose.sample!r} is neither sphere nor figure")
        hits = scene.trace(device.rig_from_camera[:3, 3], rays(device, sample_points(device, 1)))
        of_body = scene.card.on_body(hits.points)
        normals = np.full((device.height_px * device.width_px, 3), np.nan, np.float32)
        normals[hits.ray[of_body]] = hits.normals[of_body] @ device.rig_from_camera[:3, :3] * [1, -1, -1]
        return {"path": self._save("normals", pose, camera, normals.reshape(device.height_px, device.width_px, 3))}

    def btf(
        self, pose: Pose, camera: str, lamp: str, texels: int, samples: int = 3, depth_m: float = 0.0
    ) -> dict[str, Any]:
        """True BTF image (texels, texels, 3) for the lamp and the camera as they stand in this pose.

        Radiance toward the camera's true place over the lamp's irradiance on the reference plane, mean over samples x
        samples points of each texel, which lie depth_m under that plane; 1/sr, NaN where the lamp is under the plane's
        horizon.
        """
        eye_m, light = self._camera(camera).rig_from_camera[:3, 3], self._studio.lamp(pose, lamp)
        where = self._studio.to_rig(pose, self._texels(texels, samples))
        below = self._studio.to_rig(pose, self._texels(texels, samples) - [0.0, 0.0, depth_m])
        hits = self._toward(pose, eye_m, below)
        seen = np.full((len(where), 3), np.nan)
        seen[hits.ray] = self._studio.lamp_radiance(pose, hits, light, eye_m)
        ratio = seen / _plane_irradiance(light, where)
        image = ratio.reshape(texels, texels, samples**2, 3).mean(axis=2).astype(np.float32)
        return {"path": self._save("btf", pose, (camera, lamp, texels, samples, depth_m), image)}

    def _camera(self, name: str) -> CameraLayout:
        cameras = self._studio.layout.cameras
        if name not in cameras:
            raise ValueError(f"no camera {name!r}: one of {', '.join(cameras)}")
        return cameras[name]

    def _texels(self, texels: int, samples: int) -> Array:
        """Points (texels^2 * samples^2, 3) of the texels at z = 0, sample frame, texel by texel, row 0 at +y."""
        side_m = self._studio.layout.holder.opening_m - 2 * self._studio.layout.holder.margin_m
        inside = (np.arange(samples) + 0.5) / samples
        row, col, down, right = np.meshgrid(np.arange(texels), np.arange(texels), inside, inside, indexing="ij")
        x, y = (col + right) / texels * side_m - side_m / 2, side_m / 2 - (row + down) / texels * side_m
        return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])

    def _toward(self, pose: Pose, eye_m: Array, targets_m: Array) -> Hits:
        way = targets_m - eye_m
        return self._studio.trace(pose, eye_m, way / np.linalg.norm(way, axis=1, keepdims=True))

    def _laser(self, pose: Pose) -> dict[str, Any]:
        laser = self._studio.layout.laser
        source = laser.source(pose.light_arc_rad, pose.laser_elevation_rad)
        record: dict[str, Any] = {"on": pose.laser_on, "source_m": source.tolist(), "fan_rad": None, "planes": []}
        if pose.laser_on and pose.laser_sweep is not None:
            planes = [laser.plane(pose.light_arc_rad, pose.laser_elevation_rad, fan) for fan in pose.laser_sweep]
            record["fan_rad"] = list(pose.laser_sweep)
            record["planes"] = [{"normal": normal.tolist(), "offset_m": offset} for normal, offset in planes]
        return record

    def _mosaic(self, camera: str, pose: Pose) -> Path:
        path = self._name("radiance", pose, camera, "npy")
        if path not in self._mosaics:
            np.save(path, self._rate(camera, pose))
            self._mosaics.add(path)
        return path

    def _save(self, what: str, pose: Pose | None, key: object, values: np.ndarray) -> str:
        path = self._name(what, pose, key, "npy")
        np.save(path, values)
        return str(path)

    def _write(self, what: str, pose: Pose | None, record: dict[str, Any]) -> str:
        path = self._name(what, pose, None, "json")
        path.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
        return str(path)

    def _name(self, what: str, pose: Pose | None, key: object, suffix: str) -> Path:
        rig = (self._studio.seed, self._studio.layout.size)
        digest = hashlib.blake2b(repr((*rig, pose, key)).encode(), digest_size=8).hexdigest()
        folder = self._folder / what
        folder.mkdir(parents=True, exist_ok=True)
        return folder / f"{digest}.{suffix}"


def _turned_to_origin(rig_from_camera: Array) -> Array:
    """Axes (3, 3) of the camera, turned as little as makes it look at the origin."""
    forward = -rig_from_camera[:3, 3] / np.linalg.norm(rig_from_camera[:3, 3])
    right = rig_from_camera[:3, 0] - (rig_from_camera[:3, 0] @ forward) * forward
    right = right / np.linalg.norm(right)
    return np.column_stack([right, np.cross(forward, right), forward])


def limb_circle(camera: CameraLayout, radius_m: float) -> tuple[Array, float]:
    """Centre (2,) and radius in pixels of the circle fitted to the image of a sphere's limb, sphere at the origin."""
    eye_m = camera.rig_from_camera[:3, 3]
    distance = float(np.linalg.norm(eye_m))
    axis = eye_m / distance
    side = np.cross(axis, [0.0, 0.0, 1.0] if abs(axis[2]) < 0.9 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    angle = np.linspace(0, 2 * np.pi, 720, endpoint=False)[:, None]
    ring = np.cos(angle) * side + np.sin(angle) * np.cross(axis, side)
    sine = radius_m / distance  # the limb's circle lies this share of the radius toward the eye
    limb = project(camera, radius_m * (sine * axis + np.sqrt(1 - sine**2) * ring))
    centre: Array = limb.mean(axis=0)
    return centre, float(np.linalg.norm(limb - centre, axis=1).mean())


def _plane_irradiance(lamp: Lamp, points_m: Array) -> Array:
    """Irradiance (n, 3) of the reference plane at points (n, 3) of it; NaN where the lamp is not above it."""
    way = lamp.position_m - points_m
    square = np.sum(way**2, axis=1)
    cosine = way[:, 2] / np.sqrt(square)
    falling = np.where(cosine > 0, lamp.reach_m**2 / square * cosine, np.nan)
    return np.asarray(falling[:, None] * lamp.strength, np.float64)
