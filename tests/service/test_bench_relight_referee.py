"""The judges of relit radiance: Mitsuba, the paper's merge, and direct summation agree where they ought to."""

import numpy as np
import pytest

from processing.lighting.brdfs import ggx
from processing.lighting.directions import sample_directions
from processing.lighting.light import EnvironmentLight
from processing.lighting.shells import ShellPlan
from service.bench_curves import curves_figure
from tests.benchmarks.relights import referee, tradeoff
from tests.benchmarks.yardsticks.merge_operands import merge_operands
from tests.benchmarks.yardsticks.mitsuba_relit import MirrorFacets, panorama
from tests.benchmarks.yardsticks.relit_furniture import windows
from tests.benchmarks.yardsticks.teapot_scene import FLOOR, TEAPOT, WHITE, teapot_scene
from tests.reference.merge import merged_light


def test_mitsuba_sees_what_direct_summation_does():
    """Noise of 1024 samples leaves a percent of the mean at a vertex, a fifth of that in the mean of 20."""
    pytest.importorskip("mitsuba", reason="Mitsuba is not installed")
    scene = teapot_scene(0.5, 16)
    for number, vertices in enumerate(referee._drawn(scene, 20)):
        theirs = referee._judged(scene, number, vertices, referee.diffuse(np.full(3, 0.7)), 1024)
        found = scene.direct(vertices, sample_directions(13), windows(), (WHITE, WHITE))
        apart = referee._differences(found, theirs)
        assert abs(apart["mean_difference"]) < 0.01
        assert apart["median"] < 0.015


def test_the_panorama_of_the_referee_holds_the_light_where_it_is():
    """Of a room with windows: what it sheds on five faces, by Mitsuba's own layout of rows and columns."""
    environment, rows = windows(), 65
    picture = panorama(environment, rows).astype(float)
    polar, turn = np.pi * np.arange(rows) / (rows - 1), np.pi * (np.arange(2 * rows) + 0.5) / rows
    sine, cosine = np.sin(polar)[:, None], np.cos(polar)[:, None]
    toward = np.stack(np.broadcast_arrays(sine * np.sin(turn), cosine, -sine * np.cos(turn)), axis=-1)
    solid = 2 * np.pi * sine / np.sin(polar).sum() / rows
    normals = np.array([[0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    found = [
        (np.maximum(toward @ normal, 0)[..., None] * solid[..., None] * picture).sum(axis=(0, 1)) for normal in normals
    ]
    assert np.allclose(found, environment.irradiance(normals), rtol=0.02)


def test_facets_hide_more_where_their_two_terms_are_multiplied():
    rng = np.random.default_rng(1)
    ways = rng.normal(size=(2, 200, 3))
    ways[..., 2] = np.abs(ways[..., 2]) + 0.05
    light, view = ways / np.linalg.norm(ways, axis=-1, keepdims=True)
    product, correlated = (
        brdf.evaluate(light, view) for brdf in (MirrorFacets(0.6), ggx(np.zeros(3), np.ones(3), 0.6))
    )
    assert (product <= correlated * (1 + 1e-12)).all()
    above = np.array([[0.0, 0.0, 1.0]])
    assert np.allclose(
        MirrorFacets(0.6).evaluate(above, view[:1]), ggx(np.zeros(3), np.ones(3), 0.6).evaluate(above, view[:1])
    )


def test_the_merge_of_the_benchmark_gives_the_radiance_of_a_moving_frame():
    scene, sampled = teapot_scene(0.35, 10), sample_directions(10)
    vertices, places = np.arange(scene.first[-1]), [pose[:3, 3] for pose in scene.poses]
    bodies = scene.relit(scene.cuts(vertices, sampled, 0.01), scene.field(vertices, sampled, ShellPlan(6)))
    relit = scene.relighting(bodies, sampled, windows(), (WHITE, WHITE)).frame().radiance
    sums = EnvironmentLight(windows(), sampled).turned(np.eye(3)).sums
    for body, first, count in zip((TEAPOT, FLOOR), scene.first, np.diff(scene.first), strict=False):
        some = np.arange(0, count, 7)
        merged = [merged_light(*merge_operands(bodies, places, sampled, body, vertex), sums) for vertex in some]
        assert np.allclose(np.array(merged) * 0.7 / np.pi, relit[first + some], rtol=1e-4, atol=1e-5)


def test_errors_are_drawn_over_both_parameters():
    errors = np.array([[0.06, 0.03], [0.07, 0.05]])
    rows = [{"part": "tradeoff", **row} for row in tradeoff._curves(errors, (0.002, 0.008), (8, 16))]
    assert len(rows) == 8
    figure = curves_figure("relight", rows)
    assert [axes.get_xlabel() for axes in figure.axes[:2]] == ["spheres of the field", "tolerance of the cuts"]
