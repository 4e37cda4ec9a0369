"""A scene under light from all around: what is turned, moved or painted is found anew, and nothing else.

Source: Iwasaki et al., V, eq. 3 and 4; the eye, the light, reflectances and poses may change from frame to frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.errors import GeometryError
from processing.lighting.brdfs import Brdf, lambert
from processing.lighting.cached_kernel import CachedFrame, frame_in_threads
from processing.lighting.directions import SampleDirections
from processing.lighting.kept_steps import KeptSteps
from processing.lighting.light import EnvironmentLight, LeafLight, checked_rotation
from processing.lighting.lobe_nodes import Surface
from processing.lighting.moving_kernel import Steps, merged_steps, moving_frame
from processing.lighting.surroundings import RelitBody, Surroundings, part_of
from processing.products.arrays import Float32, Float64
from processing.products.light_environment import Environment
from processing.threads import in_parts

Int64 = NDArray[np.int64]

_PART = 256  # vertices that a thread takes at a time
_WHITE = 0.8


class Recomputed(NamedTuple):
    """Of how many vertices radiance came from fields anew, from visibility that was known, or stayed as it was."""

    moving: int
    cached: int
    kept: int


@dataclass(frozen=True, eq=False)
class Frame:
    """Radiance (n, 3) of the vertices that were asked for, and how it was found."""

    radiance: Float32
    recomputed: Recomputed


class Relighting:
    """Bodies under an environment; vertices are numbered through all bodies, one after another.

    Bodies start white, where their own frames are, seen from the origin; every change is told by a method and takes
    effect in the next `frame`. `cached_frame` finds light past bodies that stand still, in threads unless told.
    """

    def __init__(
        self,
        bodies: Sequence[RelitBody],
        sampled: SampleDirections,
        environment: Environment,
        cached_frame: CachedFrame = frame_in_threads,
    ) -> None:
        self._sampled = sampled
        self._lit = [_LitBody(body, sampled, cached_frame) for body in bodies]
        self.first = np.concatenate([[0], np.cumsum([len(body.body.vertices) for body in bodies])])
        self._poses = [np.eye(4) for _ in bodies]
        self._light, self._turn, self._eye = EnvironmentLight(environment, sampled), np.eye(3), np.zeros(3)
        self._leaf_lights: dict[bytes, LeafLight] = {}
        self._moved = set(range(len(bodies)))

    def look_from(self, eye: Float64) -> None:
        """Put the eye at a point (3,)."""
        if not np.array_equal(eye, self._eye):
            self._eye = _finite(eye, (3,), "eye")
            for lit in self._lit:
                if not lit.brdf.constant:
                    lit.known[:] = False

    def light_with(self, environment: Environment) -> None:
        """Exchange the environment."""
        self._light = EnvironmentLight(environment, self._sampled)
        self._relight()

    def turn_light(self, world_from_light: Float64) -> None:
        """Turn the environment by a rotation (3, 3)."""
        self._turn = checked_rotation(world_from_light)
        self._relight()

    def paint(self, number: int, brdf: Brdf) -> None:
        """Give a body another reflectance."""
        self._lit[number].brdf = brdf
        self._lit[number].known[:] = False

    def move(self, number: int, world_from_body: Float64) -> None:
        """Put a body where this rigid transform (4, 4) says. Raises GeometryError where it is not rigid."""
        pose = _finite(world_from_body, (4, 4), "pose")
        checked_rotation(pose[:3, :3])
        if np.array_equal(pose, self._poses[number]):
            return
        if not np.array_equal(pose[:3, :3], self._poses[number][:3, :3]):
            self._lit[number].known[:] = False
        elif not self._lit[number].brdf.constant:
            self._lit[number].known[:] = False
        self._poses[number] = pose
        self._moved.add(number)

    def frame(self, visible: Int64 | None = None) -> Frame:
        """Radiance of vertices (n,) in ascending order, else of all."""
        self._meet()
        wanted = np.arange(self.first[-1]) if visible is None else np.asarray(visible, np.int64)
        bounds = np.searchsorted(wanted, self.first)
        radiance, counts = np.empty((len(wanted), 3), np.float32), np.zeros(3, np.int64)
        for number, lit in enumerate(self._lit):
            part = slice(bounds[number], bounds[number + 1])
            vertices = wanted[part] - self.first[number]
            pose = self._poses[number]
            eye = (self._eye - pose[:3, 3]) @ pose[:3, :3]
            counts += lit.update(vertices, self._leaf_light(pose[:3, :3]), eye)
            radiance[part] = lit.radiance[vertices]
        return Frame(radiance, Recomputed(*counts.tolist()))

    def _meet(self) -> None:
        """Tell bodies how those that moved lie to them."""
        for one, other in permutations(range(len(self._lit)), 2):
            if one in self._moved or other in self._moved:
                self._lit[one].meet(other, self._lit[other].relit, _inverse(self._poses[one]) @ self._poses[other])
        self._moved.clear()

    def _relight(self) -> None:
        self._leaf_lights.clear()
        for lit in self._lit:
            lit.known[:] = False

    def _leaf_light(self, world_from_body: Float64) -> LeafLight:
        """The light in a body's frame; bodies that are turned alike share it."""
        key = world_from_body.tobytes()
        if key not in self._leaf_lights:
            if len(self._leaf_lights) > 2 * len(self._lit):
                self._leaf_lights.clear()
            self._leaf_lights[key] = self._light.turned(world_from_body.T @ self._turn)
        return self._leaf_lights[key]


class _LitBody:
    """One body's vertices: their surroundings, what is known of their visibility, and their radiance."""

    def __init__(self, relit: RelitBody, sampled: SampleDirections, cached_frame: CachedFrame) -> None:
        count = len(relit.body.vertices)
        self.relit, self.brdf = relit, lambert(np.full(3, _WHITE))
        self.radiance, self.known = np.zeros((count, 3), np.float32), np.zeros(count, np.bool_)
        self._sampled, self._around, self._cached_frame = sampled, Surroundings(relit.body, sampled), cached_frame
        self._whole, self._rest = KeptSteps(count), KeptSteps(count)
        self._moving, self._moved_last = set[int](), frozenset[int]()
        self._rest_without = frozenset[int]()

    def meet(self, number: int, other: RelitBody, own_from_other: Float64) -> None:
        """Another body may lie elsewhere: forget what it reached and what it reaches now."""
        changed = self._around.meet(number, other, own_from_other)
        if changed is None:
            return
        self._whole.forget(changed)
        if number not in self._rest_without:
            self._rest.forget(changed)
        self.known[changed] = False
        self._moving.add(number)

    def update(self, vertices: Int64, light: LeafLight, eye: Float64) -> Int64:
        """Find the radiance of vertices where it is not known; how many were moving, cached, kept."""
        moving, self._moving = frozenset(self._moving), set()
        todo = vertices[~self.known[vertices]]
        cached = todo[self._whole.has(todo)] if moving else todo
        fresh = np.setdiff1d(todo, cached, assume_unique=True) if moving else todo[:0]
        if len(fresh):
            self._from_fields(fresh, moving, light, eye)
        if len(cached):
            self._from_whole(cached, light, eye)
        self._moved_last = moving
        self.known[todo] = True
        return np.array([len(fresh), len(cached), len(vertices) - len(todo)])

    def _from_fields(self, vertices: Int64, moving: frozenset[int], light: LeafLight, eye: Float64) -> None:
        """Where bodies move: the rest of them is merged once they have moved in two frames."""
        others = self._around.numbers
        if moving == self._moved_last and moving < others:
            if self._rest_without != moving:
                self._rest, self._rest_without = KeptSteps(len(self.known)), moving
            self._merge(self._rest, vertices, others - moving)
            steps, casting = self._rest.steps(vertices), moving
        else:
            steps, casting = self.relit.steps(vertices), others
        around = self._around.shadows(vertices, casting)

        def work(start: int, stop: int) -> None:
            part = vertices[start:stop]
            found = np.empty((len(part), 3), np.float32)
            here = _part(steps, start, stop), part_of(around, start, stop)
            moving_frame(*here, self._surface(part, eye), light.sums, found)
            self.radiance[part] = found

        in_parts(work, len(vertices), _PART)

    def _from_whole(self, vertices: Int64, light: LeafLight, eye: Float64) -> None:
        self._merge(self._whole, vertices, self._around.numbers)
        surface = self._surface(vertices, eye)
        self.radiance[vertices] = self._cached_frame(self._whole, vertices, surface, light.sums)

    def _merge(self, kept: KeptSteps, vertices: Int64, casting: frozenset[int]) -> None:
        """Keep the product of a vertex's own cut and what some bodies leave visible, where it is not kept."""
        missing = vertices[~kept.has(vertices)]
        around = self._around.shadows(missing, casting)

        def work(start: int, stop: int) -> Steps:
            own = self.relit.steps(missing[start:stop])
            return merged_steps(own, part_of(around, start, stop), len(self._sampled.directions))

        kept.add(missing, in_parts(work, len(missing), _PART))

    def _surface(self, vertices: Int64, eye: Float64) -> Surface:
        body, brdf = self.relit.body, self.brdf
        toward = eye - body.vertices[vertices]
        toward /= np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-300)
        return Surface(
            body.normals[vertices],
            toward,
            int(brdf.kind),
            brdf.parameters,
            brdf.table,
            brdf.heights,
            self._sampled.node_means,
        )


def _part(steps: Steps, start: int, stop: int) -> Steps:
    return Steps(steps.begin[start:stop], steps.end[start:stop], steps.start, steps.value)


def _inverse(pose: Float64) -> Float64:
    found = np.eye(4)
    found[:3, :3] = pose[:3, :3].T
    found[:3, 3] = -pose[:3, :3].T @ pose[:3, 3]
    return found


def _finite(values: Float64, shape: tuple[int, ...], name: str) -> Float64:
    found = np.array(values, np.float64)
    if found.shape != shape or not np.isfinite(found).all():
        raise GeometryError(f"{name}: {shape} finite numbers, not {found.tolist()}")
    return found
