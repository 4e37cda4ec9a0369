"""Bodies by the radiance of their vertices: OpenGL and NumPy draw alike; what `visible` leaves out shows nowhere."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from render.camera import Camera, look_at
from render.environment import Environment
from render.errors import GlUnavailableError, MeshError, SceneError
from render.mesh import Mesh, plain_mesh
from render.relit_bodies import Background
from render.relit_reference import RelitReference
from render.relit_view import RelitView
from render.shapes import sphere, torus

ROOT = Path(__file__).parents[2]
SIZE = (61, 44)
SEEDS = range(6)


@pytest.fixture(scope="module")
def meshes() -> list[Mesh]:
    """A ball, a torus, and a floor in two large triangles."""
    corners = np.array([[-3.0, -3.0, -1.5], [3.0, -3.0, -1.5], [3.0, 3.0, -1.5], [-3.0, 3.0, -1.5]])
    return [sphere(shape=(12, 24)), torus(shape=(16, 24)), _flat(corners, [[0, 1, 2], [0, 2, 3]])]


@pytest.fixture(scope="module")
def views(meshes: list[Mesh]) -> Iterator[tuple[RelitView, RelitReference]]:
    view = _opened(meshes)
    yield view, RelitReference(meshes)
    view.release()


@pytest.fixture
def radiance(meshes: list[Mesh]) -> np.ndarray:
    count = sum(len(mesh.positions) for mesh in meshes)
    return np.random.default_rng(1).uniform(0.0, 4.0, (count, 3)).astype(np.float32)


def _opened(meshes: list[Mesh], supersampling: int = 2) -> RelitView:
    try:
        return RelitView(meshes, supersampling)
    except GlUnavailableError as error:
        pytest.skip(str(error))


def _flat(corners: np.ndarray, triangles: list[list[int]]) -> Mesh:
    return plain_mesh(corners, np.tile([0.0, 0.0, 1.0], (len(corners), 1)), np.array(triangles, np.int32))


def _camera(seed: int) -> Camera:
    eye = np.random.default_rng(seed).normal(size=3) * [1.0, 1.0, 0.5] + [0.0, 0.0, 0.5]
    return look_at(7.0 * eye / np.linalg.norm(eye), (0.1, 0.2, -0.1), SIZE, field_of_view_rad=0.6)


def _poses(seed: int) -> list[np.ndarray]:
    """Ball and torus turned at random, apart from each other and above the floor."""
    rng = np.random.default_rng(seed)
    found = [np.eye(4) for _ in range(3)]
    for pose, x in zip(found, (-1.3, 1.3), strict=False):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        pose[:3, :3] = turn * np.linalg.det(turn)
        pose[:3, 3] = x, 0.0, 0.1
    return found


def _edge_distance_px(view: RelitReference, camera: Camera, poses: list[np.ndarray], at: np.ndarray) -> np.ndarray:
    """How far pixels at[:, 1:] (row, column) are from the nearest edge of the triangles at[:, 0]."""
    bodies = view.bodies
    image = camera.projected(bodies.in_world(poses))[bodies.triangles[at[:, 0]]]
    corners = image[:, :, :2] / image[:, :, 2:]
    along = np.roll(corners, -1, axis=1) - corners
    to = at[:, None, :0:-1] - corners
    share = np.clip((to * along).sum(axis=2) / np.maximum((along**2).sum(axis=2), 1e-12), 0.0, 1.0)
    return np.asarray(np.linalg.norm(to - share[..., None] * along, axis=2).min(axis=1))


@pytest.mark.parametrize("seed", SEEDS)
def test_triangles_are_those_of_the_reference_but_on_edges(views, seed):
    """The card places corners on a grid, of 1/256 of a pixel as a rule."""
    camera, poses = _camera(seed), _poses(seed)
    found, expected = (view.triangles(camera, poses) for view in views)
    place = np.argwhere(found != expected)
    assert len(place) < 0.02 * found.size
    one, two = found[tuple(place.T)], expected[tuple(place.T)]
    near = np.full(len(place), np.inf)
    for numbers in (one, two):
        some = numbers >= 0
        distance = _edge_distance_px(views[1], camera, poses, np.column_stack([numbers, place])[some])
        near[some] = np.minimum(near[some], distance)
    assert (near < 0.02).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_pictures_are_those_of_the_reference(views, radiance, seed):
    camera, poses = _camera(seed), _poses(seed)
    drawn, expected = (view.draw(camera, poses, radiance) for view in views)
    apart = np.abs(drawn.radiance - expected.radiance).max(axis=2)
    assert expected.mask.mean() > 0.2
    assert np.median(apart[expected.mask]) < 1e-5
    assert (apart > 1e-3).mean() < 0.02
    assert (np.abs(drawn.coverage - expected.coverage) > 1e-6).mean() < 0.01


@pytest.mark.parametrize("seed", SEEDS)
def test_vertices_that_are_not_visible_show_nowhere(views, radiance, seed):
    """Radiance that is no number at all others leaves no trace in the picture, and each that is told is seen."""
    camera, poses = _camera(seed), _poses(seed)
    for view in views:
        visible = view.visible(camera, poses)
        some = np.full_like(radiance, np.nan)
        some[visible] = radiance[visible]
        assert np.isfinite(view.draw(camera, poses, some).radiance).all()
        assert (np.diff(visible) > 0).all()
        assert len(visible) < 0.8 * len(radiance)


def test_each_move_of_camera_or_body_is_asked_anew(views):
    """Poses may be the same array, changed in place."""
    view, reference = views
    poses, camera = _poses(0), _camera(0)
    for step in range(4):
        poses[0][1, 3] += 0.2 * (step % 2)
        seen_from = _camera(0) if step < 2 else camera.resized((step * 20, 40))
        found, expected = (each.visible(seen_from, poses) for each in (view, reference))
        assert len(np.setxor1d(found, expected)) <= 0.03 * len(expected)
        assert view.visible(seen_from, [pose.copy() for pose in poses]) is found


def test_triangles_smaller_than_a_pixel_leave_no_holes():
    """A square of 20 000 triangles in 30 x 30 pixels: covered, and drawn by visible vertices alone."""
    grid = np.stack(np.meshgrid(np.linspace(-1, 1, 101), np.linspace(-1, 1, 101), indexing="ij"), axis=-1)
    corners = np.concatenate([grid.reshape(-1, 2), np.zeros((101 * 101, 1))], axis=1)
    first = (np.arange(100)[:, None] * 101 + np.arange(100)).ravel()
    quads = np.concatenate([[first, first + 101, first + 102], [first, first + 102, first + 1]], axis=1).T
    camera = look_at((0.4, 0.3, 5.0), (0.0, 0.0, 0.0), (30, 30), field_of_view_rad=0.35, up=(0.0, 1.0, 0.0))
    view = _opened([_flat(corners, quads.tolist())])
    visible = view.visible(camera, [np.eye(4)])
    radiance = np.full((len(corners), 3), np.nan, np.float32)
    radiance[visible] = 2.0
    picture = view.draw(camera, [np.eye(4)], radiance)
    view.release()
    assert len(visible) < 0.9 * len(corners)
    assert (picture.coverage == 1.0).all()
    assert np.abs(picture.radiance - 2.0).max() < 1e-5


def test_degenerate_triangles_are_not_drawn():
    """Points and lines among triangles neither show nor shift the numbers of others."""
    corners = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    mesh = _flat(corners, [[0, 0, 0], [0, 3, 1], [0, 1, 2], [2, 2, 1]])
    camera = look_at((0.1, 0.2, 4.0), (0.0, 0.0, 0.0), SIZE, field_of_view_rad=0.6, up=(0.0, 1.0, 0.0))
    view = _opened([mesh])
    for each in (view, RelitReference([mesh])):
        assert set(np.unique(each.triangles(camera, [np.eye(4)]))) == {-1, 2}
        assert each.visible(camera, [np.eye(4)]).tolist() == [0, 1, 2]
    view.release()


@pytest.mark.parametrize(
    ("eye", "target"),
    [((0.0, -9.0, 0.0), (0.0, -20.0, 0.0)), ((0.0, -9.0, 40.0), (50.0, -9.0, 40.0))],
    ids=["all behind the camera", "all off the picture"],
)
def test_where_nothing_shows_no_vertex_is_asked_for(views, radiance, eye, target):
    camera = look_at(eye, target, SIZE, field_of_view_rad=0.6)
    for view in views:
        assert view.visible(camera, _poses(0)).size == 0
        assert not view.draw(camera, _poses(0), radiance).mask.any()


def test_some_behind_the_camera(views, radiance):
    """The eye hovers over the floor between ball and torus: one is behind, the floor on both sides of the eye."""
    camera, poses = look_at((0.0, 0.0, -0.9), (-1.3, 0.3, -0.9), SIZE, field_of_view_rad=1.2), _poses(2)
    one, two = (view.draw(camera, poses, radiance) for view in views)
    assert (np.abs(one.radiance - two.radiance).max(axis=2) > 1e-3).mean() < 0.02
    assert one.mask.any()


def test_from_inside_a_body_shows_what_is_outside(views, radiance):
    """Back faces are not drawn: an eye in the ball sees torus and floor, not the ball."""
    camera, poses = look_at((-1.3, 0.0, 0.1), (1.3, 0.0, -0.6), SIZE, field_of_view_rad=1.0), _poses(1)
    for view in views:
        visible = view.visible(camera, poses)
        assert visible.size
        assert visible.min() >= view.bodies.first_vertex[1]
    assert np.array_equal(*(view.draw(camera, poses, radiance).mask for view in views))


def test_interpolation_is_in_space_not_in_the_picture(meshes):
    """On a floor that recedes, a colour that is a place on it is the place where each pixel's ray meets it."""
    camera = look_at((0.0, -2.9, -1.2), (0.0, 3.0, -1.5), SIZE, field_of_view_rad=0.5)
    floor = _opened([meshes[2]], supersampling=1)
    picture = floor.draw(camera, [np.eye(4)], meshes[2].positions.astype(np.float32))
    floor.release()
    rays = _rays(camera)
    expected = camera.eye + rays * ((-1.5 - camera.eye[2]) / rays[..., 2:])
    assert picture.mask.sum() > 500
    assert np.abs(picture.radiance - expected)[picture.mask].max() < 1e-3


def test_background_is_what_the_environment_sheds_along_each_ray(views, radiance):
    """Turned, and drawn alike; its smooth light is nearly that of the ray's own direction."""
    camera, poses = _camera(3), _poses(3)
    environment = Environment(np.zeros((64, 128, 3), np.float32), azimuth_rad=0.7)
    light = ((environment.directions + 1.0) / 2.0).astype(np.float32)
    turn = poses[0][:3, :3]
    background = Background(Environment(light, azimuth_rad=0.7), turn)
    one, two = (view.draw(camera, poses, radiance, background) for view in views)
    alone = views[0].draw(camera, poses, radiance)
    free = alone.coverage == 0.0
    assert free.any()
    assert (one.coverage == 1.0).all()
    assert np.median(np.abs(one.radiance - two.radiance)) < 1e-5
    rays = _rays(camera)
    ways = rays / np.linalg.norm(rays, axis=-1, keepdims=True) @ turn
    assert np.abs(one.radiance - (ways + 1.0) / 2.0)[free].max() < 0.02
    whole = alone.coverage == 1.0
    assert np.array_equal(one.radiance[whole], alone.radiance[whole])


def test_bodies_move_by_their_poses_alone(views, radiance):
    """The camera and all bodies moved by one rigid transform give the same picture."""
    camera, poses = _camera(4), _poses(4)
    moved = np.eye(4)
    moved[:3, :3], moved[:3, 3] = poses[1][:3, :3], [3.0, -2.0, 5.0]
    other = Camera(camera.matrix, camera.camera_from_world @ np.linalg.inv(moved), camera.size)
    one = views[0].draw(camera, poses, radiance)
    two = views[0].draw(other, [moved @ pose for pose in poses], radiance)
    assert (np.abs(one.radiance - two.radiance).max(axis=2) > 1e-3).mean() < 0.01


PROGRAM = """
import logging, sys
logging.basicConfig(format="%(levelname)s %(message)s", stream=sys.stderr)
import numpy as np
from render.relit_view import open_relit_view
from render.scene import framed
from render.shapes import plane

mesh = plane()
view = open_relit_view([mesh])
camera = framed(mesh, (24, 16), azimuth_rad=0.3, elevation_rad=0.8)
picture = view.draw(camera, [np.eye(4)], np.ones((4, 3), np.float32))
print(view.name, view.visible(camera, [np.eye(4)]).tolist(), set(picture.coverage.ravel().tolist()))
"""


def test_without_opengl_the_reference_draws_after_one_notice():
    without = os.environ | {"__EGL_VENDOR_LIBRARY_FILENAMES": "/nowhere.json"}
    program = [sys.executable, "-c", PROGRAM]
    ran = subprocess.run(program, cwd=ROOT, env=without, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout == "NumPy reference [0, 1, 2, 3] {0.0, 1.0}\n"
    notices = [line for line in ran.stderr.splitlines() if line.startswith("WARNING no OpenGL")]
    assert len(notices) == 1
    assert notices[0].endswith("The NumPy reference draws instead.")


def test_what_cannot_be_drawn_is_refused_with_the_reason(views, meshes, radiance):
    camera, poses = _camera(0), _poses(0)
    stretched = np.diag([1.0, 1.0, 2.0, 1.0])
    for view in views:
        with pytest.raises(SceneError, match="2 poses for 3 bodies"):
            view.visible(camera, poses[:2])
        with pytest.raises(SceneError, match="body 1: a pose turns and shifts without stretch"):
            view.visible(camera, [poses[0], stretched, poses[2]])
        with pytest.raises(SceneError, match="three channels of"):
            view.draw(camera, poses, radiance[:-1])
        with pytest.raises(SceneError, match="no body"):
            type(view)([])
    with pytest.raises(MeshError, match="no triangles"):
        plain_mesh(meshes[2].positions, meshes[2].normals, np.zeros((0, 3), np.int32))


def _rays(camera: Camera) -> np.ndarray:
    """Directions (h, w, 3) away from the eye, not of unit length."""
    u, v = np.meshgrid(np.arange(camera.size[0]), np.arange(camera.size[1]))
    inverse = np.linalg.inv(camera.matrix).T
    return np.asarray(np.stack([u, v, np.ones_like(u)], axis=-1) @ inverse @ camera.camera_from_world[:3, :3])
