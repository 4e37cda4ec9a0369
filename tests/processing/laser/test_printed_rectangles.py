"""Two rectangles seen by a known camera: poses, the camera itself, and cameras that are not the one."""

import cv2
import numpy as np
import pytest

from processing import geometry
from processing.errors import ImageError
from processing.laser.printed_rectangles import find_rectangles, fit_rectangles

SIZE_M = (0.23, 0.13)
SHAPE = (240, 320)
MATRIX = np.array([[350.0, 0, 157.0], [0, 350.0, 123.0], [0, 0, 1]])
DISTORTION = np.array([-0.4, 0, 0, 0, 0])
WALL = geometry.rigid_from_vectors((0.25, 0.1, 0.02), (-0.06, -0.12, 0.5))
TABLE_ON_WALL = np.radians(84.0)  # no right angle: nothing may assume one


def table():
    tilt = geometry.rigid_from_vectors((TABLE_ON_WALL, 0, 0), (-0.02, 0.2, -0.05))
    return WALL @ tilt


def contour(pose, noise_px=0.0, seed=0, matrix=MATRIX):
    """The inner outline (n, 2), a point every half pixel or so, from the upper left corner."""
    width, height = SIZE_M
    corners = np.array([(0, 0, 0), (width, 0, 0), (width, height, 0), (0, height, 0)])
    share = np.linspace(0, 1, 240, endpoint=False)[:, None]
    outline = np.concatenate([a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
    points = geometry.transform_points(pose, outline)
    noise = np.random.default_rng(seed).normal(0, noise_px, (len(points), 2))
    return geometry.project(points, matrix, DISTORTION, np.eye(4)) + noise


def scene(noise_px=0.0, seed=0):
    return [contour(WALL, noise_px, seed), contour(table(), noise_px, seed + 1)]


def test_without_noise_the_rectangles_tell_the_camera():
    fit = fit_rectangles(scene(), SIZE_M, SHAPE)
    np.testing.assert_allclose(fit.lens[0], MATRIX, atol=0.5)
    assert fit.lens[1][0] == pytest.approx(-0.4, abs=2e-3)
    assert fit.corner_rad == pytest.approx(TABLE_ON_WALL, abs=1e-3)
    np.testing.assert_allclose(fit.poses[0], WALL, atol=2e-3)


def test_deviations_hold_what_noise_does():
    """Of twelve pictures: errors as large as stated, as 60 values tell; hardly one true camera contradicted."""
    sigmas, contradicted = [], 0
    for seed in range(12):
        contours = scene(0.2, 2 * seed)
        fit = fit_rectangles(contours, SIZE_M, SHAPE)
        assert fit.rms_px == pytest.approx(0.2, rel=0.1)
        found = np.array([fit.lens[0][0, 0], *fit.lens[0][:2, 2], fit.lens[1][0]])
        corner = (fit.corner_rad - TABLE_ON_WALL) / fit.corner_deviation_rad
        sigmas.append([*(found - [350, 157, 123, -0.4]) / fit.deviation, corner])
        contradicted += fit.contradicts(fit_rectangles(contours, SIZE_M, SHAPE, (MATRIX, DISTORTION)))
    assert 0.6 < np.sqrt(np.mean(np.square(sigmas))) < 1.4
    assert contradicted <= 1


@pytest.mark.parametrize(("row", "k1"), [(98.0, -0.4), (123.0, -0.25), (98.0, -0.25)])
def test_a_wrong_camera_is_contradicted(row, k1):
    """A centre 25 px off, as of pictures cut to another height, or half of the distortion: either is told."""
    wrong = MATRIX.copy()
    wrong[1, 2] = row
    own = fit_rectangles(scene(0.15), SIZE_M, SHAPE)
    given_fit = fit_rectangles(scene(0.15), SIZE_M, SHAPE, (wrong, np.array([k1, 0, 0, 0, 0])))
    assert own.contradicts(given_fit)
    assert np.isnan(given_fit.deviation).all()


def test_rectangles_seen_straight_do_not_tell_the_focal_length():
    straight = geometry.rigid(np.eye(3), (-0.1, -0.15, 0.5)), geometry.rigid(np.eye(3), (-0.1, 0.02, 0.5))
    fit = fit_rectangles([contour(pose, 0.1, k) for k, pose in enumerate(straight)], SIZE_M, SHAPE)
    assert fit.deviation[0] > 50


def test_frames_are_found_in_a_picture():
    """Dark frames on white: inner contours to half a pixel, the upper one first."""
    fine = np.full((8 * SHAPE[0], 8 * SHAPE[1], 3), 200, np.uint8)
    outlines = [contour(pose) for pose in (table(), WALL)]
    for outline in outlines:
        middle = outline.mean(axis=0)
        wider = middle + 1.12 * (outline - middle)
        for points, shade in ((wider, 20), (outline, 200)):
            cv2.fillPoly(fine, [np.rint(8 * (points + 0.5) - 0.5).astype(np.int32)], (shade,) * 3)
    picture = cv2.resize(fine, SHAPE[::-1], interpolation=cv2.INTER_AREA)
    found = find_rectangles(picture)
    assert len(found) == 2
    assert found[0][:, 1].mean() < found[1][:, 1].mean()
    for seen, drawn in zip(found, outlines[::-1], strict=True):
        nearest = np.linalg.norm(seen[:, None] - drawn[None], axis=-1).min(axis=1)
        assert np.median(nearest) < 0.5
    fit = fit_rectangles(found, SIZE_M, SHAPE)
    assert fit.corner_rad == pytest.approx(TABLE_ON_WALL, abs=np.radians(5))
    assert len(find_rectangles(np.full((*SHAPE, 3), 200, np.uint8))) == 0


def test_what_is_no_rectangle_is_refused():
    bent = contour(WALL)
    bent[:120] += [0, 25]
    with pytest.raises(ImageError, match="rectangle"):
        fit_rectangles([bent, bent], SIZE_M, SHAPE, (MATRIX, DISTORTION))
