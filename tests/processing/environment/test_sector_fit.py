"""Soft sectors of a ring, fitted to two pictures: sides to a fraction of a cell, and what has no edge."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from processing.environment.frame_sectors import Sector
from processing.environment.image_circle import CircleStatus, ImageCircle
from processing.environment.ring import ring_grid
from processing.environment.sector_fit import SoftSector, fit_sector, sectors_and_outlines

GRID = ring_grid(ImageCircle(np.array([119.5, 119.5]), 110.0, 0.05, 1.0, CircleStatus.FOUND))
ROWS, COLUMNS = (place.astype(float) for place in np.indices((len(GRID.radii_px), GRID.count)))
TRUE = SoftSector(20.3, 29.6, 100.4, 141.7, 1.0)
LIGHTS = st.sampled_from([(3.0, 3.0), (0.2, 0.2), (2.5, 0.3)])


def scenes(seed):
    """Two smooth places (2, 3, r, count), about 1."""
    noise = np.random.default_rng(seed).normal(size=(2, 3, *ROWS.shape))
    return np.exp(4 * gaussian_filter(noise, (0, 0, 20, 20), mode="wrap"))


def shown(sector, lights, seed=1, opacity=0.8):
    """Pictures in which a sector, seen through its own share, hides the scene."""
    share = opacity / (1 + np.exp(np.clip(sector.outside(ROWS, COLUMNS, GRID) / sector.soft, -50, 50)))
    return scenes(seed) * (1 - share) + share * np.asarray(lights)[:, None, None, None]


def sides(sector):
    return np.array([sector.top, sector.bottom, sector.left, sector.right])


@settings(max_examples=10, deadline=None)
@given(LIGHTS, st.lists(st.floats(-2.5, 2.5), min_size=4, max_size=4))
def test_sides_are_found_from_some_cells_off(lights, off):
    """Brighter or darker than either picture: the share is the same."""
    found = fit_sector(shown(TRUE, lights), SoftSector(*(sides(TRUE) + off), 1.0), GRID)
    assert np.abs(sides(found.sector) - sides(TRUE)).max() < 0.4
    assert found.settled
    assert found.gain > 0.5


@pytest.mark.parametrize("soft", [0.5, 1.8])
def test_the_width_of_the_edge_is_found(soft):
    true = SoftSector(*sides(TRUE), soft)
    found = fit_sector(shown(true, (3.0, 3.0)), SoftSector(*np.rint(sides(TRUE)), 1.0), GRID)
    assert found.sector.soft == pytest.approx(soft, abs=0.25)


def test_two_places_that_only_have_texture_gain_little():
    noise = np.random.default_rng(3).normal(size=(2, 3, *ROWS.shape))
    pictures = np.exp(gaussian_filter(noise, (0, 0, 2, 2), mode="wrap"))
    assert fit_sector(pictures, TRUE, GRID).gain < 0.1


def test_a_sector_that_wraps_is_whole():
    count = GRID.count
    one = SoftSector(20.0, 30.0, count - 15.0, count + 25.0, 1.0)
    assert np.array_equal(one.mask(GRID), SoftSector(20.0, 30.0, -15.0, 25.0, 1.0).mask(GRID))
    assert np.array_equal(np.roll(one.mask(GRID), 60, axis=1), SoftSector(20.0, 30.0, 45.0, 85.0, 1.0).mask(GRID))


def test_what_lies_beside_a_reflection_is_no_second_one():
    """It has one of its sides."""
    pictures = shown(TRUE, (0.1, 0.1))
    beside = [(Sector(20, 10, 100, 42), 90.0), (Sector(31, 9, 100, 42), 80.0)]
    nothing = np.zeros(ROWS.shape, np.bool_)
    mask = sectors_and_outlines(pictures, beside, nothing, GRID)
    assert np.array_equal(mask, sectors_and_outlines(pictures, beside[:1], nothing, GRID))
    assert mask[25, 120]


def test_an_outline_becomes_the_sector_that_it_is_and_else_stays():
    true = TRUE.mask(GRID)
    rough = np.roll(true, (1, 2), axis=(0, 1))
    pictures = shown(TRUE, (3.0, 3.0))
    sharpened = sectors_and_outlines(pictures, [], rough, GRID)
    assert (sharpened & true).sum() > 0.95 * (sharpened | true).sum()
    elsewhere = np.roll(true, 200, axis=1)
    assert np.array_equal(sectors_and_outlines(pictures, [], elsewhere, GRID), elsewhere)


def test_pictures_without_light_have_no_sectors():
    nothing = np.zeros(ROWS.shape, np.bool_)
    assert not sectors_and_outlines(
        np.zeros((2, 3, *ROWS.shape)), [(Sector(20, 10, 100, 42), 60.0)], nothing, GRID
    ).any()
