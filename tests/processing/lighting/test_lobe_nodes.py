"""Reflectance over nodes: light toward the eye as of every direction by itself."""

import numpy as np
import pytest

from processing.lighting.brdfs import blinn_phong, ggx, lambert, ward
from processing.lighting.cached_kernel import cached_frame
from processing.lighting.directions import sample_directions
from processing.lighting.lobe_nodes import Surface, room_for_nodes, write_nodes
from processing.lighting.moving_kernel import Steps
from tests.reference.relit import radiance_of

SAMPLED = sample_directions(12)
LEAVES = len(SAMPLED.directions)
WOOD, SHEEN = np.array([0.45, 0.3, 0.18]), np.full(3, 0.3)
LOBES = {
    "dull": blinn_phong(WOOD, SHEEN, 8.0),
    "satin": ggx(WOOD, np.full(3, 0.05), 0.55),
    "brushed": ward(WOOD, SHEEN, (0.4, 0.25)),
    "polished": blinn_phong(WOOD, SHEEN, 60.0),
}


def unit(rows):
    return rows / np.linalg.norm(rows, axis=-1, keepdims=True)


def vertices(count=60):
    """Normals, eyes up to 75 deg off them, step functions of visibility times cosine, and light with three lamps."""
    rng = np.random.default_rng(5)
    normals, eyes = unit(rng.normal(size=(count, 3))), unit(rng.normal(size=(count, 3)))
    eyes = unit(normals + eyes * rng.uniform(0, 0.95, (count, 1)))
    cosine = np.maximum(normals @ SAMPLED.directions.T, 0)
    lamps = unit(rng.normal(size=(3, 3)))
    light = 0.2 + 8 * (SAMPLED.directions @ lamps.T > 0.95).astype(float) @ rng.uniform(0, 1, (3, 3))
    return normals, eyes, cosine, light * SAMPLED.solid_angle[:, None]


def surface(brdf, normals, eyes):
    return Surface(normals, eyes, int(brdf.kind), brdf.parameters, brdf.table, brdf.heights, SAMPLED.node_means)


@pytest.mark.parametrize("name", LOBES)
def test_light_is_that_of_every_direction_by_itself(name):
    normals, eyes, cosine, light = vertices()
    count, sums = len(normals), np.zeros((LEAVES + 1, 4))
    np.cumsum(light, axis=0, out=sums[1:, :3])
    begin = np.arange(count) * LEAVES
    every = np.tile(np.arange(LEAVES), count).astype(np.uint16)
    steps = Steps(begin, begin + LEAVES, every, cosine.astype(np.float32).ravel())
    found = np.empty((count, 3), np.float32)
    cached_frame(steps, surface(LOBES[name], normals, eyes), sums, found)
    expected = np.array(
        [radiance_of(cosine[i], light, SAMPLED.directions, normals[i], eyes[i], LOBES[name]) for i in range(count)]
    )
    assert np.sqrt(np.square(found - expected).mean()) < 0.03 * expected.mean()  # what a node may differ by
    assert abs(found.mean() - expected.mean()) < 0.005 * expected.mean()


def test_nodes_cover_the_leaves_once_and_are_fine_where_the_lobe_is():
    normals, eyes, _, _ = vertices(20)
    polished = surface(LOBES["polished"], normals, eyes)
    room = room_for_nodes(LEAVES, polished.heights)
    for i in range(20):
        count = write_nodes(polished, i, room)
        sizes = np.diff(room.start[: count + 1])
        assert room.start[0] == 0
        assert room.start[count] == LEAVES
        assert (sizes > 0).all()
        assert (room.start[:count] % sizes == 0).all()
        mirrored = 2 * (normals[i] @ eyes[i]) * normals[i] - eyes[i]
        at = np.searchsorted(room.start[:count], (SAMPLED.directions @ mirrored).argmax(), side="right") - 1
        assert sizes[at] == sizes.min()


def test_what_is_one_value_is_one_node():
    normals, eyes, _, _ = vertices(1)
    white = surface(lambert(np.full(3, 0.5)), normals, eyes)
    room = room_for_nodes(LEAVES, white.heights)
    assert write_nodes(white, 0, room) == 1
    assert np.allclose(room.value[0], 0.5 / np.pi)
