"""Relit scenes: as the leaves say one by one, whatever changes from frame to frame."""

import numpy as np
import pytest

from processing.errors import GeometryError
from processing.lighting.brdfs import blinn_phong, lambert
from processing.lighting.directions import sample_directions
from processing.lighting.field import trace_field
from processing.lighting.light import EnvironmentLight
from processing.lighting.outline import FlatOutline, flat_outline
from processing.lighting.rays import Occluder
from processing.lighting.relighting import Relighting
from processing.lighting.self_visibility import self_visibility
from processing.lighting.shells import ShellPlan
from processing.lighting.surroundings import RelitBody
from processing.lighting.triangle_body import triangle_body
from processing.products.light_environment import Environment
from tests.processing.lighting.bodies import box, sphere, square
from tests.reference.relit import radiance_of

SAMPLED = sample_directions(9)
RNG = np.random.default_rng(3)
SKY = Environment(RNG.uniform(0, 2, (6, 8, 8, 3)).astype(np.float32))
TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0], [0.48, 0.64, 0.6]])
EYE = np.array([3.0, -4.0, 5.0])


def pose(shift, turn=None):
    found = np.eye(4)
    found[:3, 3] = shift
    if turn is not None:
        found[:3, :3] = turn
    return found


def relit(vertices, triangles, casts=True):
    body = triangle_body(vertices, triangles)
    cuts, _ = self_visibility(body, SAMPLED, 0.01)
    plan = ShellPlan(4, nearest=0.3, farthest=6)
    field = flat_outline(body) or trace_field(body, SAMPLED, plan.around(body.centre, body.radius))[0]
    return RelitBody(body, cuts, field if casts else None)


@pytest.fixture(scope="module")
def bodies():
    return [relit(*square(6.0), casts=False), relit(*box()), relit(*sphere(6, 0.7))]


POSES = [pose((0, 0, 0)), pose((0.8, 0.3, 0.6)), pose((-0.9, 0.2, 0.9))]


def scene(bodies, poses=POSES):
    made = Relighting(bodies, SAMPLED, SKY)
    made.look_from(EYE)
    for number, where in enumerate(poses):
        made.move(number, where)
    return made


def by_leaves(bodies, poses, brdfs, turn=TURN, eye=EYE):
    """All vertices, with the cuts and fields unpacked; each body in its own frame."""
    found = []
    for number, relit_body in enumerate(bodies):
        own = np.linalg.inv(poses[number])
        light = EnvironmentLight(SKY, SAMPLED).turned(own[:3, :3] @ turn).values
        body = relit_body.body
        for vertex in range(len(body.vertices)):
            visible = relit_body.self_visibility.leaves(vertex).astype(float)
            for other, casting in enumerate(bodies):
                if other == number or casting.field is None:
                    continue
                to_other = np.linalg.inv(poses[other]) @ poses[number]
                to_centre = np.linalg.inv(to_other)[:3] @ [*casting.body.centre, 1] - body.origins[vertex]
                if to_centre @ body.normals[vertex] <= -casting.body.radius:
                    continue  # a node across the horizon would tell of what lies under it
                point = to_other[:3, :3] @ body.origins[vertex] + to_other[:3, 3]
                seen = casting.field.visibility(point[None])[0]
                turned = SAMPLED.directions @ to_other[:3, :3].T
                visible *= seen[(turned @ SAMPLED.directions.T).argmax(axis=1)]
            toward = own[:3, :3] @ eye + own[:3, 3] - body.vertices[vertex]
            toward /= np.linalg.norm(toward)
            found.append(radiance_of(visible, light, SAMPLED.directions, body.normals[vertex], toward, brdfs[number]))
    return np.array(found)


WHITE = [lambert(np.full(3, 0.8))] * 3


@pytest.mark.parametrize("turned", [None, TURN.T])
def test_it_is_the_sum_over_the_leaves(bodies, turned):
    poses = [*POSES[:2], pose((-0.9, 0.2, 0.9), turned)]
    made = scene(bodies, poses)
    made.turn_light(TURN)
    assert np.allclose(made.frame().radiance, by_leaves(bodies, poses, WHITE), rtol=0, atol=3e-4)


def traced(bodies, poses):
    """All vertices of white bodies, every leaf's ray traced."""
    vertices = [b.body.vertices @ p[:3, :3].T + p[:3, 3] for b, p in zip(bodies, poses, strict=True)]
    shift = np.cumsum([0, *(len(v) for v in vertices)])
    triangles = np.concatenate([b.body.triangles + s for b, s in zip(bodies, shift, strict=False)])
    occluder, found = Occluder(np.concatenate(vertices), triangles), []
    for body, where in zip(bodies, poses, strict=True):
        light = EnvironmentLight(SKY, SAMPLED).turned(where[:3, :3].T).values
        rays = (SAMPLED.directions @ where[:3, :3].T).astype(np.float32)
        for origin, normal in zip(body.body.origins, body.body.normals, strict=True):
            start = (where[:3, :3] @ origin + where[:3, 3]).astype(np.float32)
            free = ~occluder.blocks(np.broadcast_to(start, rays.shape).copy(), rays)
            found.append((free * np.maximum(SAMPLED.directions @ normal, 0)) @ light * 0.8 / np.pi)
    return np.array(found)


@pytest.mark.parametrize("turned", [None, TURN.T])
def test_vertices_that_are_all_but_touched_are_as_traced(turned):
    """A ball a hundredth above a plate: the plate is dark, whatever the sample points around it see."""
    plate, ball = relit(*square(0.1), casts=False), relit(*sphere(6, 0.7))
    poses = [pose((0, 0, 0)), pose((0, 0, 0.71), turned)]
    found, expected = scene([plate, ball], poses).frame().radiance, traced([plate, ball], poses)
    own = len(plate.body.vertices)
    assert expected[:own].max() < 0.15  # under a free sky it would be 0.8
    assert np.abs(found[:own] - expected[:own]).max() < 0.01


def test_a_floor_hides_the_ground():
    """Flat bodies need no field: what is near, beyond and across their edge is as traced."""
    floor, block = relit(*square(3.0)), relit(*box())
    assert isinstance(floor.field, FlatOutline)
    poses = [pose((0, 0, 0)), pose((1.3, 0.2, 0.55), TURN)]
    found, expected = scene([floor, block], poses).frame().radiance, traced([floor, block], poses)
    assert np.abs(found[4:] - expected[4:]).max() < 0.02 * expected.max()


def test_bodies_that_move_together_stay_as_they_were(bodies):
    made = scene(bodies)
    made.frame()
    for number, where in enumerate(POSES):
        made.move(number, pose((0.5, 0, 0)) @ where)
    assert made.frame().recomputed == (0, 0, made.first[-1])


def test_a_sharp_lobe_is_as_the_leaves_say(bodies):
    """Nodes are as fine as the lobe asks for: within a twentieth of the light of the brightest vertex."""
    painted = [blinn_phong(np.full(3, 0.3), np.full(3, 0.4), n) for n in (5.0, 20.0, 60.0)]
    made = scene(bodies)
    made.turn_light(TURN)
    for number, brdf in enumerate(painted):
        made.paint(number, brdf)
    expected = by_leaves(bodies, POSES, painted)
    assert np.abs(made.frame().radiance - expected).max() < 0.05 * expected.max()


def test_what_stays_is_not_found_again(bodies):
    made = scene(bodies)
    count = made.first[-1]
    assert made.frame().recomputed == (count, 0, 0)
    assert made.frame().recomputed == (0, 0, count)
    made.look_from(EYE + 1)  # white bodies look alike from all sides
    assert made.frame().recomputed == (0, 0, count)
    made.turn_light(TURN)
    assert made.frame().recomputed == (0, count, 0)
    made.paint(1, blinn_phong(np.zeros(3), np.ones(3), 5.0))
    assert made.frame().recomputed == (0, 8, count - 8)


def test_frames_after_changes_are_frames_from_scratch(bodies):
    """In any order of moving, turning, painting and looking; the rest that stands still is merged on the way.

    What is merged is clustered, within half of what the vertices' own cuts are: a hundredth of what a body shows.
    """
    made, poses, brdfs = scene(bodies), list(POSES), list(WHITE)
    for step in range(8):
        if step < 5:
            poses[2] = pose((-0.9 + 0.3 * step, 0.2, 0.9))
            made.move(2, poses[2])
        elif step == 5:
            made.turn_light(TURN)
        elif step == 6:
            brdfs[0] = blinn_phong(np.full(3, 0.2), np.full(3, 0.5), 12.0)
            made.paint(0, brdfs[0])
        else:
            poses[1] = pose((0.2, 1.3, 0.6), TURN)
            made.move(1, poses[1])
        fresh = scene(bodies, poses)
        fresh.turn_light(TURN if step >= 5 else np.eye(3))
        fresh.paint(0, brdfs[0])
        assert np.allclose(made.frame().radiance, fresh.frame().radiance, rtol=0.01, atol=1e-3), step


def test_vertices_that_are_asked_for_are_those_of_all(bodies):
    every = scene(bodies).frame().radiance
    some = np.array([0, 3, 5, 12, 20])
    made = scene(bodies)
    assert np.array_equal(made.frame(some).radiance, every[some])
    assert np.allclose(made.frame().radiance, every, rtol=0.01, atol=1e-3)  # the others are of clustered products


def test_poses_that_are_not_rigid_are_refused(bodies):
    made = scene(bodies)
    for wrong in (np.diag([1.0, 1, -1, 1]), 2 * np.eye(4), np.full((4, 4), np.nan), np.eye(3)):
        with pytest.raises(GeometryError):
            made.move(1, wrong)
    with pytest.raises(GeometryError):
        made.look_from(np.full(3, np.inf))
