"""How far the shaders are from the NumPy reference, value by value on the same inputs."""

import numpy as np

from render.arrays import Float64, Rows
from render.materials import Material, outgoing
from render.mesh import Mesh
from render.opengl import GlRenderer
from render.scene import Light, Scene, framed, light

# Against values that are nothing beside the peak, a relative error says nothing: they are compared with this share.
_FLOOR = 1e-3

# Steep, middle and grazing light from three sides.
_LIGHTS = tuple(
    light(np.radians(azimuth), np.radians(elevation))
    for azimuth, elevation in ((40.0, 75.0), (-70.0, 40.0), (160.0, 12.0))
)


def gl_vs_reference(
    material: Material,
    mesh: Mesh,
    lights: tuple[Light, ...] = _LIGHTS,
    size: tuple[int, int] = (300, 300),
    renderer: GlRenderer | None = None,
) -> float:
    """Largest relative error of the shader over all pixels and lights, against `outgoing` in float64.

    Both sides get exactly the texture coordinates, footprint, light and view that the shader had; errors count relative
    to the value, or to a thousandth of the peak where the value is smaller. Raises GlUnavailableError where there is no
    GL.
    """
    camera = framed(mesh, size, azimuth_rad=np.radians(-35.0), elevation_rad=np.radians(35.0))
    scene = Scene.of(mesh, material, camera, lights[:1])
    own = GlRenderer() if renderer is None else renderer
    try:
        return max(_error(own, scene, each) for each in lights)
    finally:
        if renderer is None:
            own.release()


def relative_error(value: Rows, reference: Rows) -> Float64:
    """|value - reference| over max(|reference|, 1e-3 peak of the reference), element by element."""
    floor = _FLOOR * np.abs(reference).max(initial=0.0)
    return np.asarray(np.abs(value - reference) / np.maximum(np.abs(reference), max(floor, 1e-30)))


def _error(renderer: GlRenderer, scene: Scene, each: Light) -> float:
    drawn = renderer.g_buffer(scene, each)
    shared = (drawn.uv, drawn.light, drawn.view, drawn.footprint)
    inputs = (rows[drawn.mask].astype(np.float64) for rows in shared)
    reference = outgoing(scene.bodies[0].material, *inputs)
    return float(relative_error(drawn.radiance[drawn.mask], reference).max(initial=0.0))
