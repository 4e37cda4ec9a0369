"""Light directions from one sphere, and two public sets of photographs."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from processing.errors import ImageError
from processing.lamps.shading import (
    ShadingStatus,
    direction_from_highlight,
    direction_from_shading,
    highlight_centre,
    sphere_normals_seen,
)
from tests.public_data import DATA
from tests.reference.lamp_rig import angle_deg

CENTRE, RADIUS, SHAPE = np.array([50.3, 47.8]), 40.2, (96, 104)
NORMALS = sphere_normals_seen(CENTRE, RADIUS, SHAPE)
NORMALS = NORMALS[np.isfinite(NORMALS).all(axis=-1)]
UP = np.array([1.0, -1.0, -1.0])  # from x right, y down, z away to x right, y up, z toward the camera


def light(azimuth_rad, polar_rad):
    s = np.sin(polar_rad)
    return np.array([s * np.cos(azimuth_rad), s * np.sin(azimuth_rad), -np.cos(polar_rad)])


def shaded(direction, rng, strength=1000.0, sigma=10.0):
    return strength * np.maximum(NORMALS @ direction, 0) + rng.normal(0, sigma, len(NORMALS))


def test_truth_lies_within_the_deviations():
    """Attached shadow and all: half of the sphere tells nothing but that."""
    rng, normalised = np.random.default_rng(0), []
    for _ in range(120):
        true = light(rng.uniform(-np.pi, np.pi), rng.uniform(0, 1.4))
        fit = direction_from_shading(shaded(true, rng), np.full(len(NORMALS), 100.0), NORMALS)
        off, basis = fit.direction - true, np.linalg.svd(true[None])[2][1:]
        normalised.append((basis @ off) @ np.linalg.solve(basis @ fit.covariance @ basis.T, basis @ off) / 2)
    assert 0.9 < np.sqrt(np.mean(normalised)) < 1.1  # 240 numbers: 5 %


@given(st.floats(-6, 6), st.integers(0, 2**31))
@settings(max_examples=20, deadline=None)
def test_unit_and_order_do_not_matter(power, seed):
    rng = np.random.default_rng(seed)
    values, factor, order = (
        shaded(light(0.7, 0.9), np.random.default_rng(1)),
        10.0**power,
        rng.permutation(len(NORMALS)),
    )
    one = direction_from_shading(values, np.full(len(values), 100.0), NORMALS)
    other = direction_from_shading(factor * values[order], np.full(len(values), 100.0 * factor**2), NORMALS[order])
    np.testing.assert_allclose(other.direction, one.direction, atol=1e-6)
    assert other.strength == pytest.approx(factor * one.strength, rel=1e-6)


def test_gloss_and_cast_shadow_take_no_part():
    rng, true = np.random.default_rng(2), light(-0.4, 0.8)
    values = shaded(true, rng)
    half = true + np.array([0.0, 0.0, -1.0])
    values += 3000 * np.maximum(NORMALS @ (half / np.linalg.norm(half)), 0) ** 200
    values[NORMALS[:, 1] > 0.6] *= 0.1
    values[::37] = np.nan
    fit = direction_from_shading(values, np.full(len(values), 100.0), NORMALS)
    assert fit.status == ShadingStatus.OK
    assert angle_deg(fit.direction, true) < 0.3


@pytest.mark.parametrize(
    ("values", "normals", "status"),
    [
        (np.zeros(len(NORMALS)), NORMALS, ShadingStatus.NO_LIGHT),
        (np.full(len(NORMALS), np.nan), NORMALS, ShadingStatus.TOO_FEW_POINTS),
        (np.ones(5), NORMALS[:5], ShadingStatus.TOO_FEW_POINTS),
        (np.ones(90), np.tile(NORMALS[:1], (90, 1)), ShadingStatus.TOO_FEW_POINTS),
    ],
)
def test_what_tells_nothing_says_so(values, normals, status):
    rng = np.random.default_rng(3)
    noisy = values + rng.normal(0, 1e-3, len(values))
    fit = direction_from_shading(noisy, np.full(len(values), 1e-6), normals)
    assert fit.status == status
    assert np.isnan(fit.direction).all()


@given(st.floats(-np.pi, np.pi), st.floats(0, 2.6))
def test_highlights_lie_where_the_normal_halves_the_angle(azimuth_rad, polar_rad):
    true = light(azimuth_rad, polar_rad)
    normal = true + np.array([0.0, 0.0, -1.0])
    uv_px = CENTRE + RADIUS * normal[:2] / np.linalg.norm(normal)
    np.testing.assert_allclose(direction_from_highlight(uv_px, CENTRE, RADIUS), true, atol=1e-9)


def test_a_highlight_beside_the_sphere_is_refused():
    with pytest.raises(ImageError, match="not on the sphere"):
        direction_from_highlight(CENTRE + RADIUS, CENTRE, RADIUS)


def test_an_even_picture_has_no_highlight():
    with pytest.raises(ImageError, match="no highlight"):
        highlight_centre(np.full(SHAPE, 7.0), CENTRE, RADIUS)


@pytest.mark.parametrize("probe", [1, 2])
def test_published_directions_of_two_chrome_probes(probe):
    """PSBox: circles count rows from the bottom, from 1; its directions are from the median saturated pixel.

    Ours differs by the choice of the highlight's core: a pixel or two of a radius of 420.
    """
    folder = DATA / "psbox" / f"LightProbe-{probe}"
    if not folder.is_dir():
        pytest.skip(f"the photographs are not in {folder}")
    column, row, radius = np.loadtxt(folder / "circle_data.txt")
    published = np.loadtxt(folder / "light_directions.txt").T
    off = []
    for number, direction in enumerate(published, 1):
        picture = np.asarray(Image.open(folder / f"Image_{number:02d}.JPG"), np.float64).mean(axis=-1)
        centre = np.array([column - 1, picture.shape[0] - row])
        found = direction_from_highlight(highlight_centre(picture, centre, radius), centre, radius)
        off.append(angle_deg(found * UP, direction))
    assert max(off) < 0.7
    assert np.median(off) < 0.35


def test_a_chrome_and_a_gray_sphere_agree_better_than_with_the_list_beside_them():
    """The supplied list of these lights is 1 to 8 deg off; two spheres, by two methods, are closer to each other."""
    folder = DATA / "photometric-stereo"
    if not folder.is_dir():
        pytest.skip(f"the photographs are not in {folder}")
    listed = np.loadtxt(folder / "lights.txt", skiprows=1)
    chrome, gray = (
        [method(*_sphere(folder / name, number)) for number in range(12)]
        for name, method in (("chrome", _by_highlight), ("gray", _by_shading))
    )
    apart = [angle_deg(one, other) for one, other in zip(chrome, gray, strict=True)]
    from_list = [
        [angle_deg(found, given) for found, given in zip(kind, listed, strict=True)] for kind in (chrome, gray)
    ]
    assert np.median(apart) < 2.0
    assert np.median(apart) < min(np.median(off) for off in from_list)


def _sphere(folder, number):
    """A picture, and the circle of its mask: centre and radius."""
    picture, mask = (
        np.asarray(Image.open(folder / f"{folder.name}.{part}.tga"), np.float64) for part in (number, "mask")
    )
    rows, columns = np.nonzero((mask if mask.ndim == 2 else mask.mean(axis=-1)) > 127)
    centre = np.array([columns.min() + columns.max(), rows.min() + rows.max()]) / 2
    return picture.mean(axis=-1), centre, (np.ptp(columns) + np.ptp(rows) + 2) / 4


def _by_highlight(picture, centre, radius):
    return direction_from_highlight(highlight_centre(picture, centre, radius), centre, radius) * UP


def _by_shading(picture, centre, radius):
    normals = sphere_normals_seen(centre, radius, picture.shape)
    seen = np.isfinite(normals).all(axis=-1)
    return direction_from_shading(picture[seen], np.full(seen.sum(), 4.0), normals[seen]).direction * UP
