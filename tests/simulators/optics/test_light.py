from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from simulators.light import radiance, stripe_angles, stripe_profile
from simulators.scene import Hits, Material, matt

ORIGIN = np.zeros((1, 3))
UP = np.array([[0, 0, 1]], np.float32)


def _surface(material: Material, count: int = 1) -> Hits:
    return Hits(np.arange(count), np.repeat(ORIGIN, count, axis=0), np.repeat(UP, count, axis=0), material)


def _glossy(specular: float, roughness: float) -> Material:
    return Material(np.zeros((1, 3), np.float32), np.float32([specular]), np.float32([roughness]))


def _direction(polar: float, azimuth: float) -> np.ndarray:
    return np.array([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])


@settings(max_examples=40, deadline=None)
@given(st.floats(0, 1.5), st.floats(0, 1.5), st.floats(0.2, 3), st.floats(0.01, 1))
def test_a_matt_surface_sends_albedo_over_pi_of_its_irradiance(light_polar, view_polar, distance, albedo):
    source, eye = distance * _direction(light_polar, 0.3), _direction(view_polar, 2.0)
    found = radiance(_surface(matt(1, albedo)), np.array([True]), source, eye, 0.9)
    expected = albedo / np.pi * np.cos(light_polar) * (0.9 / distance) ** 2
    np.testing.assert_allclose(found[0], expected, rtol=1e-5)


def test_nothing_comes_from_shadow_or_from_light_behind():
    hits = _surface(matt(1, 0.9))
    assert not radiance(hits, np.array([False]), np.array([0, 0, 1.0]), np.array([0, 0, 1.0]), 1.0).any()
    assert not radiance(hits, np.array([True]), np.array([0, 0.1, -1.0]), np.array([0, 0, 1.0]), 1.0).any()


@settings(max_examples=40, deadline=None)
@given(st.floats(0, 1.4), st.floats(0, 1.4), st.floats(0, 3), st.floats(0.2, 1))
def test_gloss_is_reciprocal(light_polar, view_polar, azimuth, roughness):
    """Helmholtz: reflectance does not change when light and eye change places."""
    light, view = _direction(light_polar, 0.0), _direction(view_polar, azimuth)
    hits, lit = _surface(_glossy(0.04, roughness)), np.array([True])
    forth = radiance(hits, lit, light, view, 1.0)[0, 0] / light[2]
    back = radiance(hits, lit, view, light, 1.0)[0, 0] / view[2]
    assert forth == pytest.approx(back, rel=1e-4)


@pytest.mark.parametrize("polar", [0.0, 0.6, 1.1])
@pytest.mark.parametrize("roughness", [0.3, 0.6, 1.0])
def test_gloss_reflects_no_more_than_it_receives(polar, roughness):
    """A mirror-like Fresnel term of 1 loses only what facets hide; integral over the hemisphere of exits."""
    cosines, azimuths = np.meshgrid((np.arange(60) + 0.5) / 60, (np.arange(120) + 0.5) / 120 * 2 * np.pi)
    light = _direction(polar, 0.0)
    hits, lit = _surface(_glossy(1.0, roughness)), np.array([True])
    total = sum(
        radiance(hits, lit, light, _direction(np.arccos(c), a), 1.0)[0, 0] * c
        for c, a in zip(cosines.ravel(), azimuths.ravel(), strict=True)
    )
    share = total * 2 * np.pi / cosines.size / light[2]
    assert 0.3 < share < 1.02


@settings(max_examples=30, deadline=None)
@given(st.floats(0.7, 0.9), st.floats(0.0005, 0.003), st.floats(0.7, 0.9), st.floats(-0.01, 0.01))
def test_the_stripe_is_integrated_over_its_motion(angle, width, start, way):
    end = start + way
    found = stripe_profile(np.array([angle]), np.array([width]), (start, end))[0]
    samples = start + way * (np.arange(4000) + 0.5) / 4000
    expected = np.exp(-(((angle - samples) / width) ** 2) / 2).mean()
    assert found == pytest.approx(expected, abs=2e-6)


def test_consecutive_exposures_add_up_to_the_whole_pulse():
    """Frames without gaps collect all light of the passing Gaussian: sqrt(2 pi) widths."""
    edges = np.linspace(0.75, 0.85, 41)
    frames = [stripe_profile(np.array([0.8037]), np.array([0.001]), (a, b))[0] * (b - a) for a, b in pairwise(edges)]
    whole, _ = quad(lambda x: np.exp(-((x / 0.001) ** 2) / 2), -0.02, 0.02)
    assert sum(frames) == pytest.approx(whole, rel=1e-6)


def test_points_of_a_fan_plane_share_its_angle():
    source, azimuth, fan = np.array([0.3, 0.4, 0.6]), np.arctan2(0.4, 0.3), 0.77
    along = np.array([-np.sin(azimuth), np.cos(azimuth), 0])
    down = np.array([-np.cos(fan) * np.cos(azimuth), -np.cos(fan) * np.sin(azimuth), -np.sin(fan)])
    points = source + np.outer([-0.1, 0.0, 0.2], along) + np.outer([0.5, 0.7, 0.9], down)
    np.testing.assert_allclose(stripe_angles(points, source, azimuth), fan, atol=1e-12)
