"""Compute shaders find the radiance that threads of the processor find."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.lighting.brdfs import Brdf, BrdfKind, blinn_phong, ggx, lambert, tabulated, ward
from processing.lighting.cached_kernel import frame_in_threads
from processing.lighting.directions import sample_directions
from processing.lighting.kept_steps import KeptSteps
from processing.lighting.lobe_nodes import Surface
from processing.lighting.moving_kernel import Steps
from render.context import is_software
from render.errors import GlUnavailableError
from service.relit_on_card import FrameInThreads, FrameOnCard, open_cached_frame

ROOT = Path(__file__).parents[2]
SAMPLED = sample_directions(10)
LEAVES = len(SAMPLED.directions)
COLOUR, WHITE = np.array([0.5, 0.3, 0.2]), np.full(3, 0.5)


def _lobes() -> Brdf:
    """Two cosine lobes off the diagonal, and one that points below."""
    found = np.zeros(24)
    found[:3] = COLOUR / np.pi
    found[3:10] = -0.7, -0.7, 0.9, 40.0, 0.3, 0.2, 0.1
    found[10:17] = -0.9, -0.6, 0.4, 6.0, 0.1, 0.3, 0.2
    found[17:24] = 0.1, 0.1, -0.9, 3.0, 0.5, 0.5, 0.5
    return Brdf(BrdfKind.LAFORTUNE, found)


def _srf() -> Brdf:
    found = np.zeros(24)
    found[:9] = *(COLOUR / np.pi), 0.4, 0.5, 0.6, 20.0, 90.0, 0.6
    return Brdf(BrdfKind.SRF, found)


def _measured() -> Brdf:
    half = np.linspace(0, 1, 24)[:, None, None, None]
    return tabulated(np.random.default_rng(5).uniform(0.8, 1.2, (24, 7, 5, 3)) * (0.1 + 3 * np.exp(-40 * half**2)))


BRDFS = {
    "Lambert": lambert(COLOUR),
    "Blinn-Phong": blinn_phong(COLOUR, WHITE, 30.0),
    "sharp Blinn-Phong": blinn_phong(COLOUR, WHITE, 1e5),
    "Ward": ward(COLOUR, WHITE, (0.3, 0.15)),
    "sharp Ward": ward(COLOUR, WHITE, (0.01, 0.01)),
    "GGX": ggx(COLOUR, WHITE, 0.4),
    "smooth GGX": ggx(COLOUR, WHITE, 0.15),
    "table": _measured(),
    "Lafortune": _lobes(),
    "SRF": _srf(),
}


@pytest.fixture(scope="module")
def card() -> Iterator[FrameOnCard]:
    try:
        found = FrameOnCard()
    except GlUnavailableError as error:
        pytest.skip(str(error))
    yield found
    found.release()


def _steps(rng: np.random.Generator, count: int) -> Steps:
    """Functions of one to 400 steps, most of them 0 somewhere."""
    starts = [np.unique(np.append(rng.integers(0, LEAVES, rng.integers(0, 400)), 0)) for _ in range(count)]
    ends = np.cumsum([len(each) for each in starts])
    value = rng.uniform(0, 1, ends[-1]) * (rng.uniform(0, 1, ends[-1]) > 0.3)
    begin = np.concatenate([[0], ends[:-1]])
    return Steps(begin, ends, np.concatenate(starts).astype(np.uint16), value.astype(np.float32))


def _kept(rng: np.random.Generator, count: int) -> KeptSteps:
    kept = KeptSteps(count)
    kept.add(np.arange(count), [_steps(rng, count)])
    return kept


def _surface(rng: np.random.Generator, brdf: Brdf, count: int) -> Surface:
    """Vertices that face any way, some exactly up or down; eyes all around, under some of the horizons too."""
    normals, seen = rng.normal(size=(2, count, 3))
    normals[:4] = (np.array([0.0, 0.0, 1.0]) * [[1], [-1], [1], [-1]])[:count]
    for ways in (normals, seen):
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    return Surface(normals, seen, int(brdf.kind), brdf.parameters, brdf.table, brdf.heights, SAMPLED.node_means.copy())


def _sums(rng: np.random.Generator, sun: float = 0.0) -> np.ndarray:
    found = np.zeros((LEAVES + 1, 4))
    light = rng.uniform(0, 1, (LEAVES, 3))
    light[rng.integers(LEAVES)] += sun * LEAVES
    np.cumsum(light, axis=0, out=found[1:, :3])
    return found


def _apart(found: np.ndarray, expected: np.ndarray) -> float:
    """Root mean square difference over the mean."""
    return float(np.sqrt(np.square(found - expected).mean()) / expected.mean())


@pytest.mark.parametrize("name", BRDFS)
def test_radiance_is_that_of_the_threads(card, name):
    rng = np.random.default_rng(1)
    kept, surface, sums = _kept(rng, 500), _surface(rng, BRDFS[name], 500), _sums(rng)
    expected = frame_in_threads(kept, np.arange(500), surface, sums)
    assert expected.mean() > 0
    assert _apart(card(kept, np.arange(500), surface, sums), expected) < 1e-4


def test_a_sun_leaves_the_sky_its_digits(card):
    """A leaf 1e6 times the rest together: vertices that do not see it are as exact as without."""
    rng = np.random.default_rng(2)
    kept, surface, sums = _kept(rng, 300), _surface(rng, BRDFS["Lambert"], 300), _sums(rng, sun=1e6)
    expected = frame_in_threads(kept, np.arange(300), surface, sums)
    shaded = expected.max(axis=1) < 1e3
    assert 0.2 < shaded.mean() < 0.8
    found = card(kept, np.arange(300), surface, sums)
    assert _apart(found[shaded], expected[shaded]) < 1e-4
    assert _apart(found, expected) < 1e-4


@settings(max_examples=12, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    count=st.integers(1, 150),
    name=st.sampled_from(sorted(BRDFS)),
    scale=st.sampled_from([1e-6, 1.0, 1e6]),
)
def test_radiance_scales_with_light_whatever_the_vertices(card, seed, count, name, scale):
    """Of one vertex the bound is wider: rounding may split one node in two, whose value is 3 % off at most."""
    rng = np.random.default_rng(seed)
    kept, surface, sums = _kept(rng, count), _surface(rng, BRDFS[name], count), _sums(rng)
    expected = scale * frame_in_threads(kept, np.arange(count), surface, sums)
    found = card(kept, np.arange(count), surface, scale * sums)
    assert np.sqrt(np.square(found - expected).mean()) <= 3e-3 * expected.mean()


def test_some_vertices_in_any_turn_of_what_is_kept(card):
    """Added to, partly forgotten with room made anew, all forgotten and begun again."""
    rng = np.random.default_rng(3)
    sums, kept = _sums(rng), KeptSteps(300)

    def check(vertices: np.ndarray) -> None:
        surface = _surface(rng, BRDFS["Ward"], len(vertices))
        assert _apart(card(kept, vertices, surface, sums), frame_in_threads(kept, vertices, surface, sums)) < 1e-4

    kept.add(np.arange(100), [_steps(rng, 60), _steps(rng, 40)])
    check(np.arange(10, 90))
    kept.add(np.arange(100, 103), [_steps(rng, 3)])
    check(np.arange(50, 103))
    kept.forget(np.arange(300) < 70)
    kept.add(np.arange(150, 290), [_steps(rng, 140)])
    check(np.concatenate([np.arange(70, 103), np.arange(150, 290)]))
    kept.forget(np.ones(300, np.bool_))
    kept.add(np.arange(20), [_steps(rng, 20)])
    check(np.arange(20))


def test_no_vertices_are_no_work(card):
    rng = np.random.default_rng(4)
    surface = _surface(rng, BRDFS["GGX"], 4)._replace(lit=np.zeros((0, 3)), seen=np.zeros((0, 3)))
    assert card(_kept(rng, 4), np.arange(0), surface, _sums(rng)).shape == (0, 3)


def test_a_software_rasteriser_leaves_it_to_the_threads(card, caplog):
    if not is_software(card.name):
        pytest.skip(f"{card.name} is a graphics card")
    with caplog.at_level("INFO", "service.relit_on_card"):
        assert isinstance(open_cached_frame(), FrameInThreads)
    assert caplog.messages == [f"{card.name} is no graphics card. Threads of the processor find relit frames."]


PROGRAM = """
import logging, sys
logging.basicConfig(format="%(levelname)s %(message)s", stream=sys.stdout, level=logging.INFO)
from service.relit_on_card import FrameInThreads, open_cached_frame
assert isinstance(open_cached_frame(), FrameInThreads)
"""


def test_without_compute_shaders_threads_serve_after_one_line(card):
    """Mesa pretends to be of an older version; `card` says that there is an OpenGL at all."""
    old = os.environ | {"MESA_GL_VERSION_OVERRIDE": "3.3"}
    if not is_software(card.name):
        pytest.skip(f"{card.name} may not be Mesa's")
    program = [sys.executable, "-c", PROGRAM]
    ran = subprocess.run(program, cwd=ROOT, env=old, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    told = "INFO compute shaders take OpenGL 4.3; this is 3.3. Threads of the processor find relit frames."
    assert ran.stdout.splitlines() == [told]
