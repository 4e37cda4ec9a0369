"""Shadows end where rays to the light say, and a relief throws none on itself but those of its own BTF."""

import numpy as np
import pytest

from render.camera import look_at
from render.light_view import light_view
from render.reference import ReferenceRenderer
from render.scene import Body, Scene, light
from render.shadow_map import shadow_map
from render.shapes import plane, sphere, torus
from render.sights import relief_sight
from tests.render.reliefs import level, relief, waves
from tests.render.synthetic import lambertian

BALL = sphere(1.0, tiles=(6.0, 3.0), shape=(24, 48))
GREY = lambertian((0.5, 0.5, 0.5))


@pytest.fixture(scope="module")
def egg_tray():
    return relief(waves(), texels=12, deepest=0.1, steps=60)


def floor_under(height: float):
    mesh = plane(8.0, tiles=(8.0, 8.0))
    return type(mesh)(mesh.positions - [0.0, 0.0, height], mesh.normals, mesh.tangents, mesh.uv, mesh.triangles)


@pytest.mark.parametrize("material", [GREY, level(0.15)], ids=["plain", "relief"])
def test_a_ball_over_a_floor_keeps_a_disc_from_the_light(material):
    """Straight down the shadow is as large as the ball, less what its sample lies deeper."""
    bodies = (Body(BALL, material), Body(floor_under(2.0), GREY))
    side_px = 64
    kept = shadow_map(bodies, np.array([0.0, 0.0, 1.0]), side_px)
    x = np.linspace(-1.5, 1.5, 61)
    points = np.column_stack([x, np.zeros((61, 2))]) - [0.0, 0.0, 2.0]
    # Looking down, the texture is pinched: the silhouette is the equator, where tiles are 2 pi / 6 long.
    radius = 1.0 if material is GREY else 1.0 - material.deepest * 2 * np.pi / 6
    clear = np.abs(np.abs(x) - radius) > 1.5 * kept.view.pixel
    np.testing.assert_array_equal(kept.lit(points)[clear] > 0.5, (np.abs(x) > radius)[clear])


def test_beside_the_map_there_is_light():
    kept = shadow_map((Body(BALL, GREY), Body(floor_under(2.0), GREY)), np.array([0.0, 0.0, 1.0]), 32)
    assert (kept.lit(np.array([[3.9, 3.9, -2.0], [-3.9, 0.0, -2.0], [100.0, 0.0, 50.0]])) == 1.0).all()


@pytest.mark.parametrize("elevation_rad", [0.3, 0.8, 1.5])
def test_a_convex_body_throws_no_shadow_on_the_side_that_it_turns_to_the_light(egg_tray, elevation_rad):
    """Neither the mesh on itself, nor any point of the relief that it wraps."""
    toward = light(0.4, elevation_rad).direction
    camera = look_at(8 * toward + [1.0, 2.0, 0.0], (0, 0, 0), (50, 50), field_of_view_rad=0.3)
    for material in (egg_tray, level(0.2)):
        sight = relief_sight(BALL, material, camera)
        turned = sight.frames[:, 2] @ toward > 0.15
        lit = shadow_map((Body(BALL, material),), toward, 128).lit(sight.point)
        assert (lit[turned] > 1.0 - 1e-9).all()


def test_a_floor_of_relief_throws_no_shadow_on_itself():
    """Its points lie deeper than the mesh, and deeper than what a fine map leaves room for."""
    bodies = (Body(floor_under(0.0), level(0.2)),)
    toward = light(0.4, 0.7).direction
    camera = look_at((0.0, -9.0, 9.0), (0, 0, 0), (40, 30), field_of_view_rad=0.3)
    sight = relief_sight(bodies[0].mesh, bodies[0].material, camera)
    assert (shadow_map(bodies, toward, 256).lit(sight.point) > 1.0 - 1e-9).all()


def test_on_the_card_a_floor_of_relief_throws_no_shadow_on_itself_either(gl):
    bodies = (Body(floor_under(0.0), level(0.2)),)
    camera = look_at((0.0, -9.0, 9.0), (0, 0, 0), (40, 30), field_of_view_rad=0.3)
    with_shadows, without = (
        gl.draw(Scene(bodies, camera, (light(0.4, 0.7),), shadows=shadows)).radiance for shadows in (True, False)
    )
    assert without.max() > 0.0
    np.testing.assert_allclose(with_shadows, without, rtol=1e-5)


def test_a_torus_shades_its_own_far_side(egg_tray):
    """Light along its plane reaches the near half of the ring from outside only."""
    ring = torus(1.0, 0.3, shape=(16, 40))
    toward = np.array([1.0, 0.0, 0.0])
    for material in (GREY, egg_tray):
        kept = shadow_map((Body(ring, material),), toward, 64)
        assert kept.lit(np.array([[1.3, 0.0, 0.0]]))[0] == pytest.approx(1.0)
        assert kept.lit(np.array([[-0.65, 0.0, 0.0]]))[0] == 0.0


def test_in_shadow_only_ambient_light_is_left(egg_tray):
    """And without ambient light nothing; a floor of relief shows the shadow too."""
    bodies = (Body(BALL, GREY), Body(floor_under(1.5), egg_tray))
    camera = look_at((0.0, -9.0, 5.0), (0, 0, -1.5), (50, 40), field_of_view_rad=0.35)
    lights = (light(0.0, np.radians(89.0)),)
    dark, dim = (
        ReferenceRenderer(shadow_px=64).draw(Scene(bodies, camera, lights, ambient, shadows=True)).radiance
        for ambient in ((0.0, 0.0, 0.0), (0.2, 0.2, 0.2))
    )
    open_sky = ReferenceRenderer().draw(Scene(bodies, camera, lights)).radiance
    shaded = (dark == 0.0).all(axis=2) & (open_sky > 0.0).all(axis=2)
    assert shaded.sum() > 20
    assert (dim[shaded] > 0.0).all()
    assert (dark <= open_sky + 1e-6).all()


def test_what_the_light_sees_is_measured_along_its_rays():
    view = light_view(np.array([0.6, 0.0, 0.8]), [BALL.positions], 32)
    points = np.random.default_rng(1).normal(size=(20, 3))
    moved = points + 0.7 * view.toward(points)
    np.testing.assert_allclose(view.distance(points) - view.distance(moved), 0.7)
    np.testing.assert_allclose(view.projected(moved), view.projected(points), atol=1e-9)
