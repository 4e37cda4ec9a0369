"""What a frame of an SRF costs over one of a flat texture on the same mesh, and how far the shaders are from NumPy.

Frames of 600 x 600 under one light, drawn in turns by the same renderer, so that whatever else the machine does falls
on all of them. `frame_over_flat` is for the residual s . H on the worse of two meshes; rows have the other bases. Rows
of `environment` say how far a few lights are from the sum over all its pixels.
"""

import time
from dataclasses import replace

import numpy as np

from processing.products import AnisotropicPhong, BlinnPhong, Lobe, ResidualBasis, Srf
from render.comparison import gl_vs_reference
from render.environment import median_cut
from render.errors import GlUnavailableError
from render.materials import Material
from render.mesh import Mesh
from render.opengl import GlRenderer
from render.scene import Scene, framed, light
from render.shapes import captured_sphere, sphere, statue, torus
from service.bench import Result
from tests.render import synthetic

SIZE = (600, 600)
TEXELS = 256
WARM = 3  # frames that compile and upload
ROUND = BlinnPhong(np.array([0.10, 0.07, 0.05]), np.array([0.12, 0.11, 0.10]), 40.0)
DRAWN_OUT = AnisotropicPhong(ROUND.diffuse, ROUND.specular, np.array([8.0, 120.0]), 0.6)


def run(*, quick: bool) -> Result:
    """Frames of every basis on 16 000 and 84 668 triangles, errors of every shader; quick with fewer frames."""
    try:
        renderer = GlRenderer()
    except GlUnavailableError as error:
        return Result({}, [{"method": "frames", "missing": str(error)}])
    try:
        times = [row for mesh in (sphere(shape=(65, 125)), statue()) for row in frame_times(renderer, mesh, quick)]
        errors = shader_errors(renderer, (120, 120) if quick else (300, 300))
        reduced = environment_errors(renderer, 16 if quick else 32)
    finally:
        renderer.release()
    figures = {
        "frame_over_flat": max(row["over_flat"] for row in times if row["method"] == "SRF half"),
        "gl_vs_reference": max(row["error"] for row in errors),
    }
    return Result(figures, [*times, *errors, *reduced])


def frame_times(renderer: GlRenderer, mesh: Mesh, quick: bool) -> list[dict[str, object]]:
    """Median and 95th percentile over frames that took turns, in seconds and over the flat texture's median."""
    camera = framed(mesh, SIZE, azimuth_rad=np.radians(-35.0), elevation_rad=np.radians(35.0))
    lights = (light(np.radians(-35.0), np.radians(40.0)),)
    materials: dict[str, Material] = {"flat": synthetic.pattern(TEXELS)}
    materials |= {f"SRF {basis}": rough(basis, ROUND) for basis in ResidualBasis}
    materials["SRF half, drawn out"] = rough(ResidualBasis.HALF, DRAWN_OUT)
    scenes = {name: Scene.of(mesh, material, camera, lights) for name, material in materials.items()}
    seconds: dict[str, list[float]] = {name: [] for name in scenes}
    for _ in range(WARM + (5 if quick else 40)):
        for name, scene in scenes.items():
            begun_s = time.perf_counter()
            renderer.draw_unread(scene)
            seconds[name].append(time.perf_counter() - begun_s)
    flat_s = float(np.median(seconds["flat"][WARM:]))
    return [
        {"method": name, "seconds": float(np.median(taken[WARM:])), "p95_s": float(np.percentile(taken[WARM:], 95)),
         "over_flat": float(np.median(taken[WARM:])) / flat_s, "size": f"{len(mesh.triangles)} triangles",
         "renderer": renderer.name}
        for name, taken in seconds.items()
    ]  # fmt: skip


def shader_errors(renderer: GlRenderer, size: tuple[int, int]) -> list[dict[str, object]]:
    """Largest relative error of each material's shader on a torus, the statue, and the sphere of a capture."""
    materials = {
        f"shader of SRF {basis}, {name}": rough(basis, lobe)
        for basis in ResidualBasis
        for name, lobe in (("round", ROUND), ("drawn out", DRAWN_OUT))
    } | {"shader of BTF": synthetic.bricks(), "shader of flat": synthetic.pattern(TEXELS)}
    meshes = {"torus": torus(), "statue": statue(shape=(87, 60))}
    rows: list[dict[str, object]] = []
    for name, material in materials.items():
        error = {on: gl_vs_reference(material, mesh, size=size, renderer=renderer) for on, mesh in meshes.items()}
        if isinstance(material, Srf):
            ends = replace(material, wrap=False)
            error["sphere"] = gl_vs_reference(ends, captured_sphere(), size=size, renderer=renderer)
        rows.append({"method": name, "error": max(error.values()), **error})
    return rows


def environment_errors(renderer: GlRenderer, height: int) -> list[dict[str, object]]:
    """Root mean square error over a sphere's pixels, over their mean, of few lights against one for every pixel."""
    mesh, environment = sphere(shape=(48, 96)), synthetic.daylight(height)
    camera = framed(mesh, (64, 64), azimuth_rad=np.radians(50.0), elevation_rad=np.radians(20.0))
    rows: list[dict[str, object]] = []
    for name, exponent in (("matt", None), ("exponent 40", 40.0), ("exponent 200", 200.0)):
        specular = np.full(3, 0.0 if exponent is None else 0.12)
        material = rough(ResidualBasis.HALF, BlinnPhong(ROUND.diffuse, specular, exponent or 1.0))
        pictures = {
            count: renderer.draw(Scene.of(mesh, material, camera, median_cut(environment, count)))
            for count in (1, 4, 16, 64, 256, 2 * height**2)
        }
        full = pictures.popitem()[1]
        for count, picture in pictures.items():
            error = (picture.radiance - full.radiance)[full.mask]
            rows.append({"method": f"environment, {name}", "parameter": "lights for an environment", "value": count,
                         "error": float(np.sqrt(np.mean(error**2)) / full.radiance[full.mask].mean()),
                         "unit": "shares of the mean"})  # fmt: skip
    return rows


def rough(basis: ResidualBasis, lobe: Lobe) -> Srf:
    """A residual without any smoothness, a fifth of the diffuse colour: the most that taps can cost and err."""
    rng = np.random.default_rng(basis.size)
    residual = rng.normal(scale=0.02, size=(3, TEXELS, TEXELS, basis.size)).astype(np.float32)
    return Srf(residual, lobe, wrap=True, basis=basis)
