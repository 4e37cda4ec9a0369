"""The benchmark's other ways to draw relief are right where it is known what they must show."""

from collections.abc import Iterator

import numpy as np
import pytest

from render.camera import look_at
from render.mesh import grid_mesh
from render.opengl import GlRenderer
from render.scene import framed, light
from render.shapes import cylinder_surface, placed, plane_surface, sphere_surface
from tests.benchmarks.yardsticks.figure_scenes import CoveredMesh, FigureScene
from tests.benchmarks.yardsticks.relief_peers import METHODS, ReliefMaps, ReliefRenderer, relief_maps

SIZE = (100, 80)
SEARCHING = [method for method in METHODS if method != "parallax, offset limiting"]
KEY = light(0.3, 0.9, 2.0)


@pytest.fixture(scope="module")
def peers(gl: GlRenderer) -> Iterator[ReliefRenderer]:
    drawn = ReliefRenderer(gl.context)
    yield drawn
    drawn.release()


def even(deepest: float, texels: int = 16) -> ReliefMaps:
    """Everything as deep as the deepest point, matt, of a smooth pattern."""
    shapes = np.zeros((texels, texels, 4), np.uint8)
    shapes[..., :2], shapes[..., 2:] = 128, 255
    colours = np.zeros((texels, texels, 4), np.uint8)
    wave = 128 + 100 * np.sin(2 * np.pi * (np.arange(texels) + 0.5) / texels)
    colours[..., 0], colours[..., 1], colours[..., 2] = wave, wave[:, None], 200
    return ReliefMaps(shapes, colours, deepest)


def alone(surface, tiles, shape, camera) -> FigureScene:
    mesh = grid_mesh(surface, shape, tiles)
    return FigureScene((CoveredMesh(mesh, surface, tiles, "even"),), camera or framed(mesh, SIZE, **VIEW), (KEY,))


VIEW = {"azimuth_rad": -0.4, "elevation_rad": 0.6}


@pytest.mark.parametrize("method", METHODS)
def test_relief_without_depth_is_the_surface_itself(peers, method):
    """A Lambertian sphere: values follow the cosine to the light, to the codes of albedo and normal (1 / 255 each)."""
    figure = alone(sphere_surface(), (4, 2), (48, 96), None)
    maps = even(1e-6)
    maps.colours[..., :3] = 153
    picture = peers.draw(method, figure, {"even": maps})
    brightest = picture.radiance.max()
    assert brightest == pytest.approx(2.0 * 0.6 / np.pi, rel=0.01)
    assert picture.mask.sum() == peers.draw("relief", figure, {"even": maps}).mask.sum()


@pytest.mark.parametrize("method", SEARCHING)
def test_even_depth_on_a_plane_is_a_lower_plane(peers, method):
    """Within the picture of both; the search ends on the bottom, so nothing but rounding is between them."""
    camera = look_at([1.2, -1.5, 1.6], [0.0, 0.0, 0.0], SIZE, field_of_view_rad=0.3)
    depth, tiles = 0.06, (2, 2)
    lower = np.eye(4)
    lower[2, 3] = -depth * 2.0  # a plane of side 4 has tiles 2 long
    inset = peers.draw(method, alone(plane_surface(4.0), tiles, (1, 1), camera), {"even": even(depth)})
    below = alone(placed(plane_surface(4.0), lower), tiles, (1, 1), camera)
    true = peers.draw(method, below, {"even": even(1e-6)})
    assert inset.mask.all()
    np.testing.assert_allclose(inset.radiance, true.radiance, atol=0.01 * true.radiance.max())


def test_bent_rays_draw_a_thinner_cylinder(peers):
    """Even depth on a cylinder is a cylinder of smaller radius, to a pixel at each border; the others leave it thick.

    The rays' parabola is right to the square of depth over radius, 0.6 % here.
    """
    radius, depth, tiles = 0.5, 0.08, (6, 2)
    length = 2 * np.pi * radius / tiles[0]
    camera = look_at([40.0, 0.0, 0.0], [0.0, 0.0, 0.0], SIZE, field_of_view_rad=0.03)
    figure = alone(cylinder_surface(radius, 4 * length), tiles, (8, 192), camera)
    wide = {m: peers.draw(m, figure, {"even": even(depth)}).mask[SIZE[1] // 2].sum() for m in METHODS}
    scale = np.sqrt(length * 2 * length)
    assert wide["relief"] - wide["relief with silhouettes"] == pytest.approx(
        wide["relief"] * scale * depth / radius, abs=3.0
    )
    assert wide["relief"] == wide["parallax occlusion"] == wide["parallax, offset limiting"]


def test_maps_repeat_and_name_their_deepest_point():
    """Depth comes in 8 bits of the deepest; normals look up; the sample is lit by what it is made of."""
    maps = relief_maps("brick", 2, 12)
    assert maps.shapes[..., 3].max() == 255
    assert 0.01 < maps.deepest < 0.2
    assert maps.nbytes == 2 * 4 * 12 * 12
