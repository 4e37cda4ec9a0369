"""What wrapped bodies show: outlines that shrink by the depth, and pictures without holes in stressful places."""

from dataclasses import replace

import numpy as np
import pytest

from render.camera import look_at
from render.mesh import Mesh, mesh_from_uv
from render.reference import ReferenceRenderer
from render.scene import Body, Scene, framed, light
from render.shapes import cylinder, plane, sphere, torus
from render.sights import plain_sight, relief_sight
from tests.render.reliefs import level, relief, waves

SIZE = (60, 48)
BALL = sphere(1.0, tiles=(6.0, 3.0), shape=(48, 96))


@pytest.fixture(scope="module")
def egg_tray():
    return relief(waves(), texels=12, deepest=0.1, steps=60)


@pytest.mark.parametrize("depth", [0.0, 0.1, 0.2])
def test_a_ball_shrinks_by_its_depth(depth):
    """At its equator, where a tile is as long as it is wide, a tile of the ball is 2 pi / 6 long."""
    structure = level(depth)
    scale = 2 * np.pi / 6
    ball = replace(BALL, uv=BALL.uv)
    camera = look_at((400.0, 0.0, 0.0), (0, 0, 0), (100, 100), field_of_view_rad=0.006)
    sight = relief_sight(ball, structure, camera)
    row = sight.pixel[sight.pixel // 100 == 50]
    pixel = 2 * 400 * np.tan(0.003) / 100
    assert len(row) * pixel == pytest.approx(2 * (1 - scale * structure.deepest), abs=2 * pixel)


def test_without_depth_everything_is_where_the_mesh_is():
    """Zero displacement: the same pixels, points and texels as without a relief."""
    camera = framed(BALL, SIZE, azimuth_rad=0.3, elevation_rad=0.4)
    plain, wrapped = plain_sight(BALL, camera)[0], relief_sight(BALL, level(0.0), camera)
    order = np.argsort(wrapped.pixel)
    np.testing.assert_array_equal(wrapped.pixel[order], plain.pixel)
    np.testing.assert_allclose(wrapped.point[order], plain.point, atol=1e-12)
    np.testing.assert_allclose(wrapped.uv[order], plain.uv, atol=1e-12)


def test_deeper_than_the_body_nothing_is_left():
    """Maximal displacement: a sample deeper than the ball is thick is met nowhere but along its own rays inward."""
    camera = framed(BALL, SIZE, azimuth_rad=0.3, elevation_rad=0.4)
    deep = level(0.99)
    few = relief_sight(replace(BALL, uv=BALL.uv / 6), deep, camera)
    assert len(few.pixel) < 0.2 * len(plain_sight(BALL, camera)[0].pixel)


def test_seams_and_mirrored_texture_change_no_outline(egg_tray):
    """An egg tray looks the same mirrored; a torus whose texture is mirrored is covered as before."""
    mesh = torus(1.0, 0.4, tiles=(6.0, 2.0), shape=(24, 60))
    camera = framed(mesh, SIZE, azimuth_rad=0.3, elevation_rad=0.4)
    mirrored = mesh_from_uv(mesh.positions, mesh.normals, mesh.uv * [-1.0, 1.0], mesh.triangles)
    one, other = relief_sight(mesh, egg_tray, camera), relief_sight(mirrored, egg_tray, camera)
    differing = np.setxor1d(one.pixel, other.pixel)
    assert len(differing) <= 0.01 * len(one.pixel)


def test_triangles_without_area_change_nothing(egg_tray):
    mesh = torus(1.0, 0.4, shape=(24, 60))
    camera = framed(mesh, SIZE, azimuth_rad=0.3, elevation_rad=0.4)
    flat = np.concatenate([mesh.triangles, mesh.triangles[:50][:, [0, 1, 1]]])
    one, other = relief_sight(mesh, egg_tray, camera), relief_sight(replace(mesh, triangles=flat), egg_tray, camera)
    np.testing.assert_array_equal(one.pixel, other.pixel)
    np.testing.assert_allclose(one.point, other.point)


def test_an_open_mesh_keeps_its_outline(egg_tray, caplog):
    """And says why; its points lie at their depth under it."""
    caplog.set_level("INFO")
    floor = plane(2.0, tiles=(3.0, 3.0))
    camera = look_at((3.0, -3.0, 1.0), (0, 0, 0), SIZE, field_of_view_rad=0.7)
    wrapped = relief_sight(floor, egg_tray, camera)
    np.testing.assert_array_equal(wrapped.pixel, plain_sight(floor, camera)[0].pixel)
    assert "open" in caplog.text
    scale = 2 / 3
    assert (wrapped.point[:, 2] <= 1e-12).all()
    assert (wrapped.point[:, 2] >= -scale * egg_tray.deepest - 1e-9).all()
    assert np.ptp(wrapped.point[:, 2]) > 0.5 * scale * egg_tray.deepest


def test_a_grazing_view_shows_finite_points_under_the_mesh(egg_tray):
    tube = cylinder(0.5, 2.0, tiles=(6.0, 4.0), shape=(8, 48))
    camera = look_at((6.0, 0.0, 1.001), (0, 0, 1.0), SIZE, field_of_view_rad=0.4)
    sight = relief_sight(tube, egg_tray, camera)
    assert len(sight.pixel)
    for values in (sight.point, sight.uv, sight.view, sight.frames):
        assert np.isfinite(values).all()
    assert (np.hypot(*sight.point[:, :2].T) <= 0.5 + 1e-3).all()


def test_what_a_gap_in_the_relief_leaves_free_shows_the_body_behind(egg_tray):
    """Objects behind objects: each pixel shows the nearest of what is met, and a second torus through the first."""
    near = torus(1.0, 0.4, shape=(24, 60))
    far = Mesh(near.positions - [6.0, 0.0, 0.0], near.normals, near.tangents, near.uv, near.triangles)
    camera = look_at((8.0, 0.0, 3.0), (0, 0, 0), SIZE, field_of_view_rad=0.5)
    lights = (light(0.3, 1.0),)
    alone = [ReferenceRenderer().draw(Scene.of(mesh, egg_tray, camera, lights)).coverage for mesh in (near, far)]
    scene = Scene((Body(far, egg_tray), Body(near, egg_tray)), camera, lights)
    both = ReferenceRenderer().draw(scene)
    np.testing.assert_array_equal(both.coverage, np.maximum(*alone))
    first = ReferenceRenderer().draw(Scene.of(near, egg_tray, camera, lights))
    np.testing.assert_allclose(both.radiance[alone[0] > 0], first.radiance[alone[0] > 0])
