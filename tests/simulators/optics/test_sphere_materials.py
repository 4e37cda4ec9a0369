"""The materials of the spheres are what they say: of energy, of light past the terminator, of sheen and highlight."""

from dataclasses import replace

import numpy as np
import pytest

from simulators.layout import build_layout
from simulators.light import radiance
from simulators.samples.spheres import SPHERES
from simulators.scene import Below, Grain, Hits, Material
from simulators.scene_sphere import SphereScene

FAR_M = 1e5


def _around(count: int) -> np.ndarray:
    """Unit vectors (count, 3) all around, evenly (Fibonacci's spiral)."""
    z = 1 - 2 * (np.arange(count) + 0.5) / count
    azimuth = np.pi * (1 + 5**0.5) * np.arange(count)
    return np.column_stack([np.sqrt(1 - z**2) * np.cos(azimuth), np.sqrt(1 - z**2) * np.sin(azimuth), z])


def _seen(material: Material, lights: np.ndarray, view: np.ndarray) -> np.ndarray:
    """Radiance (n, k, 3) of k points that face up under each of n distant lights (n, 3).

    The lamp is at the origin and far from every point, each on its own side of it; the eye is further still.
    """
    n, k = len(lights), len(material.albedo)
    points = np.repeat(-FAR_M * lights, k, axis=0)
    hits = Hits(np.arange(n * k), points, np.tile(np.array([0, 0, 1], np.float32), (n * k, 1)), _repeated(material, n))
    return radiance(hits, np.ones(n * k, bool), np.zeros(3), FAR_M**2 * view, FAR_M).reshape(n, k, 3)


def _repeated(material: Material, times: int) -> Material:
    def each(values: np.ndarray) -> np.ndarray:
        return np.tile(values, (times,) + (1,) * (values.ndim - 1))

    return Material(
        each(material.albedo),
        each(material.specular),
        each(material.roughness),
        None if material.below is None else Below(each(material.below.albedo), each(material.below.spread)),
        None if material.sheen is None else each(material.sheen),
        None if material.grain is None else Grain(*map(each, vars(material.grain).values())),
    )


def _slanted(angle_deg: float) -> np.ndarray:
    return np.array([np.sin(np.radians(angle_deg)), 0.0, np.cos(np.radians(angle_deg))])


def _patches(name: str, count: int = 12) -> Material:
    """Laid flat: grain runs along x and y in turn."""
    material = SPHERES[name](_around(count), 3)[1]
    if material.grain is None:
        return material
    return replace(material, grain=replace(material.grain, along=np.eye(3, dtype=np.float32)[np.arange(count) % 2]))


def _grooved(roughness: tuple[float, float], reflectance: float = 0.3) -> Material:
    """One point of bare metal with its grain along x."""
    nothing = np.zeros((1, 3), np.float32)
    grain = Grain(np.float32([[1, 0, 0]]), np.float32([roughness]), np.full((1, 3), reflectance, np.float32))
    return Material(nothing, nothing[:, 0], nothing[:, 0] + 1, grain=grain)


@pytest.mark.parametrize("name", ["sphere-glaze", "sphere-wax", "sphere-cloth", "sphere-brushed"])
@pytest.mark.parametrize("angle_deg", [0.0, 55.0, 80.0])
def test_no_more_light_leaves_than_falls_in(name, angle_deg):
    """Light from all around, also past the horizon where the body lets it through, toward one view."""
    count = 6000  # lobes are 3 deg wide and more, the lights 2.6 deg apart
    out = _seen(_patches(name), _around(count), _slanted(angle_deg)).sum(axis=0) * 4 * np.pi / count
    assert 0.01 < out.min() < out.max() <= 1


def test_what_spreads_below_the_surface_is_neither_more_nor_less_in_all():
    """Of a body whose surface reflects nothing at normal incidence, the mean over all lights depends little on spread.

    Schlick's term at grazing incidence, which the spread moves past the horizon, is what is left of a difference.
    """

    def total(spread: float) -> float:
        below = Below(np.full((1, 3), 0.5, np.float32), np.full((1, 3), spread, np.float32))
        nothing = np.zeros((1, 3), np.float32)
        material = Material(nothing, np.zeros(1, np.float32), np.ones(1, np.float32), below)
        return float(_seen(material, _around(2000), _slanted(0.0))[..., 0].mean())

    assert total(0.45) == pytest.approx(total(0.0), rel=1e-3)


@pytest.mark.parametrize("name", SPHERES)
def test_only_wax_shines_past_the_terminator_and_there_it_is_red(name):
    seen = _seen(_patches(name), np.array([_slanted(102.0)]), _slanted(0.0))[0]
    if name == "sphere-wax":
        red, green, blue = (seen / _patches(name).below.albedo).T
        assert (red > 1.2 * green).all()
        assert (green > 1.2 * blue).all()
        assert (blue > 0).all()
    else:
        assert not seen.any()


def test_wax_on_the_sphere_shines_further_round_than_stone():
    """The lit share of the sphere seen from the side of the light."""

    def lit_share(name: str) -> float:
        scene = SphereScene(build_layout(1, "small").sphere, 1, SPHERES[name])
        hits = scene.normal_hits(_around(3000))
        source = np.array([0.0, 0.6, 0.0])
        return float(np.mean(radiance(hits, scene.lit(hits, source), source, np.array([1.1, 0, 0]), 0.6)[:, 0] > 0))

    assert lit_share("sphere-wax") > lit_share("sphere") + 0.15  # to 117 deg instead of 85: 0.27 of the sphere more


def test_the_sheen_of_cloth_grows_to_grazing():
    """What sheen adds, light and view on opposite sides, over what the threads reflect without it."""
    cloth = _patches("sphere-cloth")
    bare = replace(cloth, sheen=None)
    added = []
    for angle_deg in (0.0, 30.0, 60.0, 80.0):
        lights = np.array([_slanted(angle_deg)])
        full, less = (_seen(material, lights, _slanted(angle_deg)) for material in (cloth, bare))
        added.append(((full - less) / lights[0, 2]).mean())
    assert added[0] == 0  # fibres stand upright: nothing comes straight back
    assert np.all(np.diff(added) >= 0)
    back = [_seen(replace(cloth, albedo=0 * cloth.albedo), np.array([_slanted(a)]), _slanted(a)).mean()
            / np.cos(np.radians(a)) for a in (0.0, 80.0)]  # fmt: skip
    assert back[1] > 5 * back[0]


def test_the_glaze_has_one_body_colour_and_a_bright_small_highlight():
    """At the mirror's angle it is several times as bright as the body, ten degrees beside it the body is all."""
    glaze = _patches("sphere-glaze")
    assert np.ptp(glaze.below.albedo, axis=0).max() == 0
    at, beside = (_seen(glaze, np.array([_slanted(a)]), _slanted(-20.0))[0, 0] for a in (20.0, 40.0))
    assert at[1] > 8 * beside[1]
    first, second = ((values[2] - values[0]) / np.cos(np.radians(a)) for values, a in ((at, 20.0), (beside, 40.0)))
    assert first == pytest.approx(second, rel=0.03)  # the highlight is white: channels differ by the body alone


@pytest.mark.parametrize("name", SPHERES)
def test_surfaces_look_outward_and_belong_to_the_seed(name):
    places = _around(4000)
    normals, material = SPHERES[name](places, 5)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
    assert np.einsum("nk,nk->n", normals, places).min() > 0.4
    again, _ = SPHERES[name](places, 5)
    np.testing.assert_array_equal(again, normals)
    assert 0 < material.diffuse.min() <= material.diffuse.max() < 1
    if name != "sphere-glaze":
        assert np.any(SPHERES[name](places, 6)[0] != normals)


def test_threads_of_cloth_cross_over_and_under():
    """Along the equator the two kinds of thread take turns, and the relief tilts both ways across each."""
    angle = np.linspace(-0.3, 0.3, 3000)
    circle = np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
    normals, material = SPHERES["sphere-cloth"](circle, 5)
    red = material.albedo[:, 0] > material.albedo[:, 2]
    crossings = np.count_nonzero(np.diff(red.astype(int)))
    assert crossings >= 0.6 / (np.pi / 2) * 34 - 2  # threads in 0.6 rad, each of which ends in the other kind
    sideways = np.einsum("nk,nk->n", normals, np.gradient(circle, axis=0) / np.gradient(angle)[:, None])
    assert sideways.min() < -0.3
    assert sideways.max() > 0.3


def test_metal_that_reflects_all_gives_back_no_more_than_falls_in():
    """Facets without a loss of their own, the grain along and across the view; light between them is not followed."""
    lights = _around(6000)
    for angle_deg in (0.0, 40.0, 75.0):
        for view in (_slanted(angle_deg), _slanted(angle_deg)[[1, 0, 2]]):
            out = _seen(_grooved((0.3, 0.55), 1.0), lights, view)[..., 1].sum() * 4 * np.pi / len(lights)
            assert 0.8 < out < 1.003  # a sum over lights 2.6 deg apart


def test_equal_roughness_along_and_across_is_the_round_lobe():
    nothing = np.zeros((1, 3), np.float32)
    gloss = Material(nothing, np.float32([0.3]), np.float32([0.4]))
    lights = _around(500)
    for view in (_slanted(0.0), _slanted(50.0), _slanted(70.0)[[1, 0, 2]]):
        found, expected = (_seen(material, lights, view) for material in (_grooved((0.4, 0.4)), gloss))
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-9)
        assert expected.max() > 0


def test_the_highlight_of_brushed_metal_is_longer_across_the_grain():
    """Seen from straight above, the angle at which it has fallen to a half, along the grain and across it."""
    angles_deg = np.arange(0.0, 80.0, 0.5)
    lights = np.stack([_slanted(angle) for angle in angles_deg])
    brushed, cosine = _patches("sphere-brushed", 2), lights[:, 2]
    along, across = _seen(brushed, lights, _slanted(0.0))[..., 1].T / cosine  # the second has its grain along y
    width_along, width_across = (angles_deg[np.argmax(one < one[0] / 2)] for one in (along, across))
    assert width_across > 2 * width_along > 0


def test_metal_colours_its_highlight_and_is_dark_beside_it():
    brushed = _patches("sphere-brushed")
    at, beside = (_seen(brushed, np.array([_slanted(angle)]), _slanted(-20.0))[0] for angle in (20.0, 85.0))
    assert (at[:, 0] > at[:, 1]).all()
    assert (at[:, 1] > 1.5 * at[:, 2]).all()
    assert (at[::2] > 300 * beside[::2]).all()  # where the grain lies in the plane of light and view


def test_light_and_view_may_change_places_on_brushed_metal():
    brushed, ways = _patches("sphere-brushed"), _around(40)[:18]  # up to 84 deg from the normal
    reflectance = np.stack([_seen(brushed, ways, view) / ways[:, 2, None, None] for view in ways])
    # The eye is 1e-5 off its direction as the points see it, and the lobe changes by 44 times that along the grain.
    np.testing.assert_allclose(reflectance, reflectance.swapaxes(0, 1), rtol=1e-3)


def test_grain_of_brushed_metal_runs_along_circles_of_the_surface():
    places = np.vstack([_around(2000), [[0, 1, 0], [0, -1, 0]]])
    normals, material = SPHERES["sphere-brushed"](places, 5)
    np.testing.assert_allclose(np.linalg.norm(material.grain.along, axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(np.einsum("nk,nk->n", material.grain.along, normals), 0, atol=1e-6)
    np.testing.assert_allclose(material.grain.along[:, 1], 0, atol=1e-6)
    assert (material.grain.roughness[:, 1] > material.grain.roughness[:, 0] + 0.1).all()
