import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from processing.products import normals_of, sphere_normals, sphere_uv, tangent_frames

GRADIENT = st.floats(-1e6, 1e6, allow_nan=False)


@given(GRADIENT, GRADIENT)
def test_frame_is_orthonormal_and_right_handed_for_every_gradient(p, q):
    frame = tangent_frames(normals_of(np.array(p), np.array(q)))
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    assert abs(np.linalg.det(frame) - 1) < 1e-12


@given(st.floats(-1, 1), st.floats(-1, 1))
def test_frame_follows_the_texture(p, q):
    """t is where u grows and v stands still on the sphere's parallel; b is upward in the image, against v."""
    tangent, binormal, normal = tangent_frames(normals_of(np.array(p), np.array(q)))
    assert tangent[0] > 0
    assert tangent[1] == 0
    assert binormal[1] < 0
    step = 1e-6
    u, v = (sphere_uv(normal + step * way) - sphere_uv(normal) for way in (tangent, binormal))
    assert u[0] > 0
    assert v[1] < 0


def test_frame_is_the_papers_turned_by_half_a_turn(rng):
    """t = (-sin theta, 0, -cos theta), b = (-sin phi cos theta, cos phi, sin phi sin theta), both negated."""
    normal = normals_of(*rng.uniform(-1, 1, (2, 500)))
    phi = np.arcsin(normal[:, 1])
    theta = np.arccos(normal[:, 0] / np.cos(phi))
    tangent = np.stack([-np.sin(theta), 0 * theta, -np.cos(theta)], axis=1)
    binormal = np.stack([-np.sin(phi) * np.cos(theta), np.cos(phi), np.sin(phi) * np.sin(theta)], axis=1)
    frames = tangent_frames(normal)
    np.testing.assert_allclose(frames[:, 0], -tangent, atol=1e-12)
    np.testing.assert_allclose(frames[:, 1], -binormal, atol=1e-12)


def test_poles_have_a_frame():
    """cos phi = 0 leaves theta open; the frame there is still one."""
    for sign in (1.0, -1.0):
        frame = tangent_frames(np.array([0.0, sign, 0.0]))
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-15)
        assert np.linalg.det(frame) > 0.999


def test_map_and_sphere_agree_on_texture_coordinates():
    normals = sphere_normals(16)
    row, column = np.mgrid[:16, :16]
    np.testing.assert_allclose(sphere_uv(normals), np.stack([(column + 0.5) / 16, (row + 0.5) / 16], axis=-1))
