"""Mitsuba 3 as referee of the truth of covered bodies: the same triangles, matt, in another tracer and another shading.

Its diffuse surface is the only one that both have, so samples are compared without their gloss.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from render.camera import Camera
from render.picture import Picture
from render.scene import Light
from tests.benchmarks.yardsticks.covered import Covered
from tests.benchmarks.yardsticks.displaced import Displaced

Array = NDArray[Any]

VARIANT = "scalar_rgb"


def matt(body: Covered) -> Covered:
    """The body with a sample of the same shape and albedo, without gloss."""
    surface = body.sample.surface.copy()
    surface[:, 3] = 0.0
    return replace(body, sample=replace(body.sample, surface=surface))


def rendered(displaced: Displaced, camera: Camera, light: Light, samples: int) -> Picture:
    """The bodies under one light, the mean of so many samples to a pixel; raises ImportError without mitsuba."""
    import mitsuba as mi  # type: ignore[import-not-found, unused-ignore]

    mi.set_variant(VARIANT)
    scene = {
        "type": "scene",
        "integrator": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0},
        "sensor": _sensor(mi, camera, samples),
        "light": {"type": "directional", "direction": list(-light.direction), "irradiance": _rgb(light.irradiance)},
    }
    scene |= {f"piece_{number}": _mesh(mi, *piece) for number, piece in enumerate(displaced.pieces())}
    image = np.array(mi.render(mi.load_dict(scene)))
    return Picture(np.ascontiguousarray(image[:, :, :3]), np.ascontiguousarray(image[:, :, 3]))


def _sensor(mi: Any, camera: Camera, samples: int) -> dict[str, Any]:
    right_down_forward = camera.camera_from_world[:3, :3]
    eye, forward = camera.eye, right_down_forward[2]
    view = mi.ScalarTransform4f().look_at(
        origin=eye.tolist(), target=(eye + forward).tolist(), up=(-right_down_forward[1]).tolist()
    )
    return {
        "type": "perspective",
        "fov": float(np.degrees(2 * np.arctan(0.5 * min(camera.size) / camera.matrix[0, 0]))),
        "fov_axis": "smaller",
        "to_world": view,
        "film": {
            "type": "hdrfilm",
            "width": camera.size[0],
            "height": camera.size[1],
            "pixel_format": "rgba",
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": "stratified", "sample_count": samples},
    }


def _rgb(value: Array) -> dict[str, Any]:
    return {"type": "rgb", "value": list(map(float, value))}


def _mesh(mi: Any, vertices: Array, faces: Array, normals: Array, albedo: Array) -> Any:
    """A matt mesh whose albedo is told at its vertices."""
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(
        {"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "vertex_albedo"}}
    )
    mesh = mi.Mesh("piece", len(vertices), len(faces), has_vertex_normals=True, props=properties)
    mesh.add_attribute("vertex_albedo", 3, albedo.astype(np.float32).ravel())
    content = mi.traverse(mesh)
    content["vertex_positions"] = vertices.astype(np.float32).ravel()
    content["vertex_normals"] = normals.astype(np.float32).ravel()
    content["faces"] = faces.astype(np.uint32).ravel()
    content.update()
    return mesh
