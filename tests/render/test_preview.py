"""Pictures: both renderers draw the same, light adds up, windows change, memory goes back."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import moderngl
import numpy as np
import pytest

from processing.products import AnisotropicPhong
from render.camera import look_at
from render.errors import GlUnavailableError, SceneError
from render.flat import FlatTexture
from render.mesh import mesh_from_uv
from render.opengl import GlRenderer
from render.preview import Preview
from render.rasteriser import rasterise
from render.reference import ReferenceRenderer
from render.scene import Light, Scene, framed, light, orbiting_light, turning_lights
from render.shapes import captured_sphere, plane, sphere, statue, torus, vase
from tests.render import synthetic

KEY = light(np.radians(-60.0), np.radians(50.0), (3.0, 2.5, 2.0))
FILL = light(np.radians(20.0), np.radians(10.0), 0.7)
SCENES = {
    "srf sphere": ("srf", sphere(shape=(48, 96))),
    "srf vase": ("srf", vase(shape=(48, 64))),
    "btf plane": ("btf", plane(tiles=(2.0, 2.0))),
    "btf torus": ("btf", torus(shape=(32, 72))),
    "srf captured sphere": ("srf", captured_sphere(shape=(48, 96))),
}
SIZE = (150, 120)


def scene_of(mesh, material, *lights: Light) -> Scene:
    """The mesh from a corner."""
    camera = framed(mesh, SIZE, azimuth_rad=np.radians(-35.0), elevation_rad=np.radians(35.0))
    return Scene.of(mesh, material, camera, lights or (KEY,))


def held_by(renderer: GlRenderer) -> list[object]:
    """Everything that occupies memory of the card."""
    card = renderer._card
    return [
        *(buffer for each in card._geometries.values() for buffer in (each.vertices, each.triangles)),
        *(texture for each in card._materials.values() for texture in each.binding.textures.values()),
        *(held for each in card._targets.values() for held in (*each.images, each.depth, *each.framebuffers.values())),
        *card._programs.values(),
    ]


def interior(mask: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Covered pixels whose eight neighbours are covered and belong to the same piece of surface."""
    grown = np.pad(np.where(mask, depth, np.inf), 1, constant_values=np.inf)
    shifted = [grown[r : r + mask.shape[0], c : c + mask.shape[1]] for r in range(3) for c in range(3)]
    with np.errstate(invalid="ignore"):
        step = np.abs(np.stack(shifted) - np.where(mask, depth, 0.0)).max(axis=0)
    return mask & (step < 0.15)


@pytest.mark.parametrize("name", SCENES)
def test_both_renderers_draw_the_same_picture(gl, request, name):
    """Inside the outline to 1e-3 of the peak (vertices are snapped to 1/256 px); coverage differs only along it."""
    kind, mesh = SCENES[name]
    scene = scene_of(mesh, request.getfixturevalue(kind), KEY, FILL)
    drawn, reference = gl.draw(scene), ReferenceRenderer().draw(scene)
    fragments = rasterise(mesh, scene.camera)
    depth = np.zeros(SIZE[0] * SIZE[1])
    depth[fragments.pixel] = fragments.depth
    inside = interior(reference.mask, depth.reshape(SIZE[1], SIZE[0]))
    assert inside.sum() > 0.7 * reference.mask.sum()
    assert drawn.mask[inside].all()
    differs = drawn.mask != reference.mask
    assert differs.sum() <= 0.002 * reference.mask.sum()
    assert not (differs & inside).any()
    error = np.abs(drawn.radiance - reference.radiance).max(axis=2)[inside]
    assert error.max() <= 1e-3 * reference.radiance.max()


@pytest.fixture(params=["gl", "reference"])
def renderer(request):
    return request.getfixturevalue("gl") if request.param == "gl" else ReferenceRenderer()


def test_radiance_is_linear_float32_and_zero_beside_the_object(renderer, srf):
    picture = renderer.draw(scene_of(sphere(shape=(24, 48)), srf))
    assert picture.radiance.dtype == np.float32
    assert picture.radiance.shape == (120, 150, 3)
    assert not picture.mask.all()
    np.testing.assert_array_equal(picture.radiance[~picture.mask], 0.0)


def test_more_lights_are_the_sum_of_each(renderer, srf):
    mesh = torus(shape=(24, 48))
    lights = [light(a, e, i) for a, e, i in ((0.0, 0.8, 1.0), (2.0, 0.3, 0.5), (4.0, 1.2, 2.0), (-1.0, 0.1, 0.3))]
    together = renderer.draw(scene_of(mesh, srf, *lights)).radiance
    apart = sum(renderer.draw(scene_of(mesh, srf, each)).radiance.astype(np.float64) for each in lights)
    np.testing.assert_allclose(together, apart, atol=1e-6 * np.abs(apart).max(), rtol=1e-5)


def test_irradiance_scales_each_channel(renderer, srf):
    mesh = sphere(shape=(24, 48))
    white = renderer.draw(scene_of(mesh, srf, replace(KEY, irradiance=np.ones(3)))).radiance
    coloured = renderer.draw(scene_of(mesh, srf, KEY)).radiance
    np.testing.assert_allclose(coloured, white * KEY.irradiance, rtol=1e-5, atol=1e-7)


def test_light_from_below_leaves_a_plane_black(renderer, btf):
    picture = renderer.draw(scene_of(plane(), btf, light(0.3, -0.2)))
    assert picture.mask.any()
    np.testing.assert_array_equal(picture.radiance, 0.0)


def test_matt_plane_is_albedo_times_cosine_over_pi(renderer):
    albedo = (0.8, 0.5, 0.2)
    for elevation in (90.0, 50.0, 12.0):
        lit = light(1.0, np.radians(elevation), 2.0)
        for material in (synthetic.lambertian(albedo), FlatTexture(np.broadcast_to(np.float32(albedo), (4, 4, 3)))):
            picture = renderer.draw(scene_of(plane(), material, lit))
            expected = 2.0 * np.sin(np.radians(elevation)) * np.array(albedo) / np.pi
            shown = picture.radiance[picture.mask]
            np.testing.assert_allclose(shown, np.broadcast_to(expected, shown.shape), rtol=1e-5)


def test_matt_sphere_shows_the_cosine_of_its_normals(renderer):
    """On the sphere the normal is the place: the brightest pixel faces the light."""
    mesh = sphere(shape=(48, 96))
    scene = scene_of(mesh, synthetic.lambertian((0.5, 0.5, 0.5)), replace(KEY, irradiance=np.ones(3)))
    picture = renderer.draw(scene)
    fragments = rasterise(mesh, scene.camera)
    normal = fragments.interpolate(mesh, mesh.normals)
    cosine = np.maximum((normal / np.linalg.norm(normal, axis=1, keepdims=True)) @ KEY.direction, 0.0)
    shown = picture.radiance.reshape(-1, 3)[fragments.pixel, 0]
    both = picture.mask.ravel()[fragments.pixel]
    np.testing.assert_allclose(shown[both], 0.5 / np.pi * cosine[both], atol=1e-4)


def test_ambient_light_comes_from_straight_above(renderer, srf):
    """A plane seen with ambient light only equals the plane lit along its normal."""
    dark = light(0.0, -1.0)
    ambient = replace(scene_of(plane(), srf, dark), ambient=(0.3, 0.2, 0.1))
    along_normal = scene_of(plane(), srf, light(0.0, np.pi / 2, (0.3, 0.2, 0.1)))
    np.testing.assert_allclose(
        renderer.draw(ambient).radiance, renderer.draw(along_normal).radiance, rtol=1e-4, atol=1e-6
    )


def test_ambient_light_is_off_by_default(srf):
    assert scene_of(plane(), srf).ambient == (0.0, 0.0, 0.0)


def test_mirrored_texture_coordinates_mirror_the_bumps(renderer):
    """A plane whose u runs backward, under a light from the right, is the mirror image of the plain one from the left.

    That holds only where the frame is mirrored with the texture: bumps along t then turn round, lobes do too.
    """
    bumpy = synthetic.stone(32, 32)
    lobe = AnisotropicPhong(bumpy.phong.diffuse, bumpy.phong.specular, np.array([5.0, 90.0]), 0.5)
    flat = plane()
    backward = mesh_from_uv(flat.positions, flat.normals, flat.uv * [-1.0, 1.0] + [1.0, 0.0], flat.triangles)
    assert (backward.tangents[:, 3] == -1.0).all()
    camera = look_at((0.0, 0.0, 5.0), (0.0, 0.0, 0.0), (81, 81), field_of_view_rad=0.5, up=(0.0, 1.0, 0.0))
    pictures = [
        renderer.draw(Scene.of(mesh, replace(bumpy, phong=lobe), camera, (light(azimuth, 0.6),))).radiance
        for mesh, azimuth in ((flat, 0.3), (backward, np.pi - 0.3))
    ]
    np.testing.assert_allclose(pictures[0][:, ::-1], pictures[1], atol=1e-4 * pictures[0].max())
    assert np.abs(pictures[0] - pictures[1]).max() > 0.1 * pictures[0].max()


@pytest.mark.parametrize("elevation_rad", [0.5 * np.pi, -0.5 * np.pi])
def test_poles_of_the_sphere_and_the_statue_are_drawn_without_holes(gl, srf, elevation_rad):
    """Where the texture shrinks to a point both renderers still draw numbers, and the same ones."""
    for mesh in (sphere(shape=(24, 48)), statue(shape=(60, 40))):
        camera = framed(mesh, (81, 81), azimuth_rad=0.0, elevation_rad=elevation_rad)
        scene = Scene.of(mesh, srf, camera, (light(0.4, elevation_rad * 0.7),))
        drawn, reference = gl.draw(scene), ReferenceRenderer().draw(scene)
        middle = np.s_[36:45, 36:45]
        assert drawn.mask[middle].all()
        assert np.isfinite(drawn.radiance).all()
        error = np.abs(drawn.radiance - reference.radiance)[middle]
        assert np.median(error) <= 1e-3 * reference.radiance.max()


def test_a_surface_hides_what_lies_behind_it(gl, flat):
    """The near side of the torus covers the far side: depth decides, not the order of triangles."""
    mesh = torus(shape=(24, 48))
    turned = replace(mesh, triangles=np.ascontiguousarray(mesh.triangles[::-1]))
    one, other = gl.draw(scene_of(mesh, flat)), gl.draw(scene_of(turned, flat))
    np.testing.assert_array_equal(one.radiance, other.radiance)


def test_scene_without_light_is_refused(srf):
    camera = look_at((0.0, -3.0, 1.0), (0.0, 0.0, 0.0), SIZE, field_of_view_rad=0.5)
    with pytest.raises(SceneError, match="no light"):
        Scene.of(plane(), srf, camera, ())


def test_more_lights_than_one_pass_takes_are_the_sum_of_all(gl, srf):
    """150 lights are three passes of the shader; ambient light counts once."""
    rng = np.random.default_rng(2)
    lights = [light(a, e, i) for a, e, i in rng.uniform((0, -0.5, 0), (6.3, 1.5, 0.02), (150, 3))]
    scene = replace(scene_of(torus(shape=(24, 48)), srf, *lights), ambient=(0.3, 0.2, 0.1))
    drawn = gl.draw(scene).radiance.astype(np.float64)
    dark = light(0.0, -0.5 * np.pi, 0.0)
    apart = sum(gl.draw(replace(scene, lights=(each,), ambient=(0.0, 0.0, 0.0))).radiance for each in lights)
    apart = apart + gl.draw(replace(scene, lights=(dark,))).radiance
    np.testing.assert_allclose(drawn, apart, atol=1e-5 * np.abs(apart).max(), rtol=1e-5)


def test_lights_turn_together(srf):
    turned = list(turning_lights(scene_of(plane(), srf, KEY, FILL), 4))
    np.testing.assert_allclose(turned[0].lights[1].direction, FILL.direction)
    quarter = np.array([-FILL.direction[1], FILL.direction[0], FILL.direction[2]])
    np.testing.assert_allclose(turned[1].lights[1].direction, quarter, atol=1e-12)


def test_orbit_closes_without_a_doubled_frame(srf):
    turns = [scene.lights[0].direction for scene in orbiting_light(scene_of(plane(), srf, KEY, FILL), 8)]
    np.testing.assert_allclose(turns[0], KEY.direction)
    np.testing.assert_allclose([d[2] for d in turns], KEY.direction[2])
    azimuth = np.unwrap([np.arctan2(d[1], d[0]) for d in turns])
    np.testing.assert_allclose(np.diff(azimuth), np.radians(45.0))


def test_swing_stays_within_its_arc(srf):
    swing = orbiting_light(scene_of(plane(), srf), 12, arc_rad=np.radians(60.0))
    azimuth = np.degrees([np.arctan2(s.lights[0].direction[1], s.lights[0].direction[0]) for s in swing])
    np.testing.assert_allclose([azimuth.min(), azimuth.max()], [-90.0, -30.0], atol=1e-9)


def test_preview_fits_the_camera_to_its_window(gl, srf):
    """A window of another size shows the same view; two pixels of the large one are one of the small."""
    scene = scene_of(sphere(shape=(24, 48)), srf)
    with_gl = Preview((60, 60), supersampling=1, renderer=gl)
    small = with_gl.draw(scene)
    with_gl.resize((120, 120))
    large = with_gl.draw(scene)
    assert with_gl.size == (120, 120)
    assert small.radiance.shape == (60, 60, 3)
    assert large.radiance.shape == (120, 120, 3)
    shrunk = large.averaged(2)
    # Single samples against means of four: the bumps are finer than a pixel, so only the means over the sphere agree.
    assert small.radiance.mean() == pytest.approx(shrunk.radiance.mean(), rel=0.02)
    assert small.mask.mean() == pytest.approx(shrunk.coverage.mean(), rel=0.02)


def test_supersampling_softens_the_outline_only_there(gl, flat):
    scene = scene_of(plane(), flat)
    picture = Preview((60, 60), supersampling=3, renderer=gl).draw(scene)
    soft = (picture.coverage > 0) & (picture.coverage < 1)
    assert 0 < soft.sum() < 0.2 * picture.mask.sum()
    assert picture.coverage.max() == 1.0


def test_window_without_pixels_is_refused():
    with pytest.raises(SceneError, match="0 x 5 pixels"):
        Preview((0, 5), renderer=ReferenceRenderer())


def test_memory_goes_back_when_the_preview_closes(srf, btf):
    """Every buffer, texture, framebuffer, program and the context itself, also after many meshes and sizes."""
    try:
        renderer = GlRenderer()
    except GlUnavailableError as error:
        pytest.skip(str(error))
    with Preview((40, 40), renderer=renderer) as preview:
        held: set[object] = set()
        for index in range(6):
            preview.resize((40 + index, 40))
            for material in (srf, btf):
                preview.draw(scene_of(plane(shape=(1, index + 1)), material))
            held |= {*held_by(renderer)}
        assert len(held) > 20
        assert len(held_by(renderer)) < len(held)
    assert all(isinstance(resource.mglo, moderngl.InvalidObject) for resource in held)
    assert not held_by(renderer)


def test_renderer_may_be_made_in_one_thread_and_draw_in_another(gl, flat):
    scene = scene_of(plane(), flat)
    expected = gl.draw(scene).radiance
    renderer = GlRenderer()
    with ThreadPoolExecutor(1) as pool:
        np.testing.assert_array_equal(pool.submit(renderer.draw, scene).result().radiance, expected)
    np.testing.assert_array_equal(renderer.draw(scene).radiance, expected)
    renderer.release()


def test_two_previews_live_side_by_side(gl, flat, srf):
    """Contexts do not disturb each other: the first still draws after the second has gone."""
    scene = scene_of(sphere(shape=(12, 24)), srf)
    before = gl.draw(scene).radiance
    with Preview((30, 30)) as other:
        other.draw(scene_of(plane(), flat))
        between = gl.draw(scene).radiance
    np.testing.assert_array_equal(gl.draw(scene).radiance, before)
    np.testing.assert_array_equal(between, before)
