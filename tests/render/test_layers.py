"""Wrapped samples and shadows on the card are those of the NumPy reference.

Both rasterise the same meshes, in float32 and float64: where a depth lies between two codes, an edge between two
pixels, or a ray just passes or meets the sample, a few pixels may differ.
"""

from dataclasses import replace

import numpy as np
import pytest

from render import shadows
from render.camera import look_at
from render.mesh import mesh_from_uv
from render.opengl import GlRenderer
from render.picture import Picture
from render.reference import ReferenceRenderer
from render.scene import Body, Scene, framed, light
from render.shadows import shadow_maps as draw_maps
from render.shapes import cylinder, plane, sphere, torus
from tests.render import synthetic
from tests.render.reliefs import level, relief, waves

SIZE, SMALL = (100, 80), (60, 48)
SHADOW_PX = 96
KEY = light(-0.4, 0.7)
# Of the pixels: single ones along the edges.
FEW = 0.01


@pytest.fixture(scope="module")
def egg_tray():
    return relief(waves(0.12), texels=16, deepest=0.12, plane=0.03, steps=60)


@pytest.fixture(scope="module")
def shading():
    renderer = GlRenderer(shadow_side_px=SHADOW_PX)
    yield renderer
    renderer.release()


def scene(*bodies: Body, elevation_rad: float = 0.5, **kind) -> Scene:
    camera = framed(bodies[0].mesh, SIZE, azimuth_rad=-0.6, elevation_rad=elevation_rad)
    return Scene(bodies, camera, (KEY,), **kind)


def floor(height: float, tiles: float = 2.0):
    mesh = plane(5.0, tiles=(tiles, tiles))
    return replace(mesh, positions=mesh.positions + np.array([0.0, 0.0, height]))


def assert_same(drawn: Picture, reference: Picture) -> None:
    """But for a few pixels the same coverage, and where both see something, the same radiance to a thousandth."""
    assert np.mean(drawn.mask != reference.mask) <= FEW
    both = drawn.mask & reference.mask
    peak = reference.radiance.max()
    off = np.abs(drawn.radiance - reference.radiance)[both].max(axis=1) > 1e-3 * peak
    assert both.any()
    assert off.mean() <= FEW


@pytest.mark.parametrize("name", ["torus", "sphere", "cylinder"])
def test_silhouettes_are_the_reference_s(gl, egg_tray, name):
    mesh = {"torus": torus(shape=(24, 60)), "sphere": sphere(shape=(24, 48)), "cylinder": cylinder()}[name]
    here = scene(Body(mesh, egg_tray))
    drawn = gl.draw(here)
    assert gl.layers >= 1
    assert_same(drawn, ReferenceRenderer().draw(here))
    whole = gl.draw(scene(Body(mesh, egg_tray.btf)))
    assert drawn.mask.sum() < whole.mask.sum()


def test_shadows_are_the_reference_s(shading, egg_tray):
    """Of a wrapped torus on itself, on an open floor of the same sample, and on and by a plain sphere."""
    ball = sphere(0.3, shape=(12, 24))
    above = replace(ball, positions=ball.positions + np.array([0.0, 0.0, 0.9]))
    bodies = (
        Body(torus(shape=(24, 60)), egg_tray),
        Body(floor(-0.6), egg_tray),
        Body(above, synthetic.lambertian((0.5, 0.4, 0.3))),
    )
    here = scene(*bodies, shadows=True, ambient=(0.1, 0.1, 0.1))
    drawn = shading.draw(here)
    assert_same(drawn, ReferenceRenderer(SHADOW_PX).draw(here))
    lit = shading.draw(replace(here, shadows=False))
    assert (lit.radiance - drawn.radiance).max() > 0.1 * lit.radiance.max()


def test_ambient_light_on_a_plain_btf_comes_from_everywhere(gl, egg_tray):
    """With and without its depths: what it returns to all lights together, not to one straight above."""
    mesh, dark = sphere(shape=(12, 24)), replace(KEY, irradiance=np.zeros(3))
    for material in (egg_tray, egg_tray.btf):
        here = replace(scene(Body(mesh, material), ambient=(0.3, 0.2, 0.1)), lights=(dark,))
        drawn = gl.draw(here)
        assert_same(drawn, ReferenceRenderer().draw(here))


def test_several_lights_have_a_shadow_map_each(shading, egg_tray):
    """What two lights give together is the sum of what each gives alone."""
    here = scene(Body(torus(shape=(24, 60)), egg_tray), Body(floor(-0.6), egg_tray), shadows=True)
    lights = (KEY, light(2.0, 0.9, (0.2, 0.4, 0.8)))
    together = shading.draw(replace(here, lights=lights)).radiance
    alone = [shading.draw(replace(here, lights=(each,))).radiance for each in lights]
    np.testing.assert_allclose(together, alone[0] + alone[1], rtol=1e-4, atol=1e-5 * together.max())


def test_shadow_maps_are_kept_while_bodies_and_lights_stay(monkeypatch):
    """Another camera needs none; a light, a body or a material that is another one does, and so does what came back."""
    drawn = []
    monkeypatch.setattr(shadows, "shadow_maps", lambda *args: drawn.append(args) or draw_maps(*args))
    renderer = GlRenderer(shadow_side_px=32)
    ball, grey = sphere(shape=(8, 16)), synthetic.lambertian((0.5, 0.4, 0.3))
    first = scene(Body(ball, grey), Body(floor(-1.2), grey), shadows=True)
    other_light = replace(first, lights=(light(2.0, 0.9),))
    other_body = replace(first, bodies=(Body(sphere(0.5, shape=(8, 16)), grey), first.bodies[1]))
    other_material = replace(first, bodies=(Body(ball, synthetic.lambertian((0.1, 0.1, 0.1))), first.bodies[1]))
    other_camera = replace(first, camera=framed(ball, SIZE, azimuth_rad=1.0, elevation_rad=0.7))
    counts = []
    pictures = []
    for each in (first, first, other_camera, other_light, other_body, other_material, first):
        pictures.append(renderer.draw(each).radiance)
        counts.append(len(drawn))
    assert counts == [1, 1, 1, 2, 3, 4, 5]
    for number in (1, 6):
        np.testing.assert_array_equal(pictures[number], pictures[0])
    for side in range(20, 33):
        renderer.draw(
            replace(first, camera=framed(ball, (side, side), azimuth_rad=1.0, elevation_rad=0.7), shadows=False)
        )
    np.testing.assert_array_equal(renderer.draw(first).radiance, pictures[0])
    renderer.release()


def test_what_stands_behind_is_seen_past_a_silhouette(gl, egg_tray):
    """A plain ball behind a wrapped one, and the other way round."""
    near, far = sphere(1.0, shape=(24, 48)), sphere(1.6, shape=(24, 48))
    camera = framed(near, SIZE, azimuth_rad=0.0, elevation_rad=0.1)
    behind = replace(far, positions=far.positions + 4.0 * (near.positions.mean(axis=0) - camera.eye) / 9.0)
    plain = synthetic.lambertian((0.5, 0.4, 0.3))
    for bodies in (
        (Body(near, egg_tray), Body(behind, plain)),
        (Body(near, plain), Body(behind, egg_tray)),
        (Body(near, egg_tray), Body(behind, egg_tray)),
    ):
        here = Scene(bodies, camera, (KEY,))
        assert_same(gl.draw(here), ReferenceRenderer().draw(here))


def test_a_sample_of_no_depth_is_the_plain_btf(gl):
    """Nothing is cut away, and nothing is displaced."""
    flat = level(0.0, texels=8)
    here = scene(Body(torus(tiles=(3.0, 3.0 * 0.42)), flat))
    drawn, plain = gl.draw(here), gl.draw(scene(Body(here.bodies[0].mesh, flat.btf)))
    np.testing.assert_array_equal(drawn.mask, plain.mask)


def test_a_second_layer_is_seen_through_the_first(egg_tray):
    """With one layer alone, what lies behind a torus's near rim is not there where the rim's sample is passed by."""
    here = scene(Body(torus(shape=(24, 60)), egg_tray), elevation_rad=0.2)
    pixels = []
    for most in (1, 2, 8):
        renderer = GlRenderer(most_layers=most)
        pixels.append(int(renderer.draw(here).mask.sum()))
        renderer.release()
    assert pixels[0] < pixels[1] <= pixels[2]


def stressed(egg_tray) -> dict[str, Scene]:
    """What a scene file or a camera may ask for, each a place where a shader may divide by nothing or lose a face."""
    ring = torus(shape=(24, 60))
    mirrored = mesh_from_uv(ring.positions, ring.normals, ring.uv * [-1.0, 1.0], ring.triangles)
    flat = replace(ring, triangles=np.concatenate([ring.triangles, ring.triangles[:50][:, [0, 1, 1]]]))
    ground = Body(floor(0.0), egg_tray)
    tube = Body(cylinder(0.5, 2.0, tiles=(6.0, 4.0), shape=(8, 48)), egg_tray)

    def seen_from(eye, at, *bodies: Body) -> Scene:
        return Scene(bodies, look_at(eye, at, SMALL, field_of_view_rad=0.7), (KEY,), shadows=True)

    return {
        "mirrored texture and seams": scene(Body(mirrored, egg_tray)),
        "triangles without area": scene(Body(flat, egg_tray)),
        "a floor seen along itself": seen_from((4.0, 0.0, 0.03), (0.0, 0.0, 0.0), ground),
        "a tube seen along its end": seen_from((6.0, 0.0, 1.001), (0.0, 0.0, 1.0), tube),
        "inside the bounding box": seen_from((0.0, 0.0, 0.0), (1.0, 0.3, 0.0), Body(ring, egg_tray)),
        "inside the body": seen_from((1.0, 0.0, 0.0), (-1.0, 0.1, 0.0), Body(ring, egg_tray)),
    }


STRESSED = (
    "mirrored texture and seams",
    "triangles without area",
    "a floor seen along itself",
    "a tube seen along its end",
    "inside the bounding box",
    "inside the body",
)


@pytest.mark.parametrize("name", STRESSED)
def test_stress_is_the_reference_s(shading, egg_tray, name):
    """Finite, and the same pixels with the same radiance."""
    here = stressed(egg_tray)[name]
    drawn, reference = shading.draw(here), ReferenceRenderer(SHADOW_PX).draw(here)
    assert np.isfinite(drawn.radiance).all()
    assert np.isfinite(reference.radiance).all()
    assert_same(drawn, reference)


def test_of_a_sample_deeper_than_its_body_nothing_is_left(gl):
    """One tile around a ring is longer than its tube is thick: no ray comes to the sample before it leaves."""
    ring = torus(shape=(24, 60))
    here = scene(Body(replace(ring, uv=ring.uv / ring.uv.max(axis=0)), level(0.99)))
    assert not ReferenceRenderer().draw(here).mask.any()
    assert not gl.draw(here).mask.any()
