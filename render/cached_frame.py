"""Radiance of vertices whose visibility is known, by compute shaders: OpenGL 4.3 and later."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass

import moderngl
import numpy as np
from numpy.typing import NDArray

from render.arrays import Float32, Float64, Rows
from render.context import open_context, renderer_name
from render.errors import GlUnavailableError
from render.on_card import OnCard, keep
from render.programs import compile_compute, set_uniform

_REQUIRED = 430
_GROUP, _HEIGHTS = 64, 16  # invocations and heights of nodes that the shader has room for
_KEPT = 24  # sums of light, tables and mean directions that stay on the card


@dataclass(frozen=True, eq=False)
class StepFunctions:
    """What vertices see as step functions over leaves: step k of vertex i is `value[k]` from leaf `start[k]` (uint16)
    on, k from `begin[i]` to `end[i]`; the first begins at leaf 0.

    `store` tells whose `start` and `value` these are, `filled` the number of their turn and how much of them is filled:
    within a turn they are only added to, so that only what is new goes to the card.
    """

    begin: NDArray[np.int64]
    end: NDArray[np.int64]
    start: NDArray[np.uint16]
    value: Float32
    store: Hashable
    filled: tuple[int, int]


@dataclass(frozen=True, eq=False)
class Surface:
    """Vertices with unit `normals` and directions `toward_eye` (n, 3), in the frame of the leaves, and reflectance.

    `kind` and `parameters` (24,) are a model of `reflectance.glsl`; `table` (half, difference, azimuth, 3) is that of
    the measured one. One value of it serves over a node of height h where the squared sine of its half angle is at
    least `least[h]`; where its cosine is less than `below[h]`, all of it is under the horizon. `means` (2 leaves, 3)
    are mean directions of nodes, that of height h over leaf k at (leaves + k) / 2^h.
    """

    normals: Float64
    toward_eye: Float64
    kind: int
    parameters: Float64
    table: Float64
    least: Float64
    below: Float64
    means: Float32


class CachedFrames:
    """Finds radiance on the card; one thread's at a time. Raises GlUnavailableError where there are no compute shaders.

    Arrays that come again as the same objects are written to the card once: they must not change. A store holds at most
    `most_steps`.
    """

    def __init__(self) -> None:
        self.context = open_context()
        if self.context.version_code < _REQUIRED:
            version = self.context.version_code / 100
            self.context.release()
            raise GlUnavailableError(f"compute shaders take OpenGL {_REQUIRED / 100:.1f}; this is {version:.1f}")
        self.name = renderer_name(self.context)
        with self.context:
            self.most_steps = int(self.context.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"]) // 4
        self._programs: dict[int, moderngl.ComputeShader] = {}
        self._stores: dict[Hashable, _Store] = {}
        self._arrays: OrderedDict[int, _Array] = OrderedDict()

    def radiance(self, steps: StepFunctions, surface: Surface, sums: Float64) -> Float32:
        """Radiance (n, 3) toward the eye; `sums` (leaves + 1, 3 or more) are the light's before each leaf."""
        count = len(steps.begin)
        if not count:
            return np.zeros((0, 3), np.float32)
        with self.context:
            program = self._program(surface.kind)
            _set_surface(program, surface, leaves=len(sums) - 1, count=count)
            store = self._stores.setdefault(steps.store, _Store(self.context))
            store.take(steps)
            buffers = [
                self.context.buffer(np.stack([steps.begin, steps.end], axis=1).astype(np.int32).tobytes()),
                self.context.buffer(_by_vertex(surface).tobytes()),
                self.context.buffer(reserve=12 * count),
            ]
            ranges, vertices, found = buffers
            shared = self._on_card(sums, _split), self._on_card(surface.means), self._on_card(surface.table)
            for place, buffer in enumerate((ranges, store.start, store.value, shared[0], vertices, *shared[1:], found)):
                buffer.bind_to_storage_buffer(place)
            program.run(-(-count // _GROUP))
            radiance = np.frombuffer(found.read(), np.float32).reshape(count, 3)
            for buffer in buffers:
                buffer.release()
        return radiance

    def release(self) -> None:
        """Give everything on the card back, the context last."""
        with self.context:
            held: list[OnCard] = [*self._programs.values(), *self._stores.values(), *self._arrays.values()]
            for each in held:
                each.release()
        self.context.release()

    def _program(self, kind: int) -> moderngl.ComputeShader:
        if kind not in self._programs:
            self._programs[kind] = compile_compute(self.context, "cached_frame.comp", frozenset({f"KIND {kind}"}))
        return self._programs[kind]

    def _on_card(self, array: Rows, form: Callable[[Rows], Rows] = np.asarray) -> moderngl.Buffer:
        """An array in the form that the shader reads, in float32."""

        def written() -> _Array:
            return _Array(array, self.context.buffer(np.ascontiguousarray(form(array), np.float32).tobytes()))

        return keep(self._arrays, id(array), written, _KEPT).buffer


@dataclass(frozen=True)
class _Array:
    """An array on the card; it is held so that its identity stays its own."""

    array: Rows
    buffer: moderngl.Buffer

    def release(self) -> None:
        self.buffer.release()


class _Store:
    """Step functions of one store on the card."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._filled = (-1, 0)
        self.start = self.value = context.buffer(reserve=4)

    def take(self, steps: StepFunctions) -> None:
        """Write what is new."""
        turn, filled = steps.filled
        if turn != self._filled[0] or len(steps.value) * 4 != self.value.size:
            self.release()
            self.start = self._context.buffer(reserve=-(-max(len(steps.start), 1) // 2) * 4)
            self.value = self._context.buffer(reserve=max(len(steps.value), 1) * 4)
            self._filled = (turn, 0)
        new = slice(self._filled[1], filled)
        self.start.write(steps.start[new].tobytes(), offset=2 * new.start)
        self.value.write(steps.value[new].tobytes(), offset=4 * new.start)
        self._filled = steps.filled

    def release(self) -> None:
        self.start.release()
        self.value.release()


def _set_surface(program: moderngl.ComputeShader, surface: Surface, *, leaves: int, count: int) -> None:
    set_uniform(program, "vertices", count)
    set_uniform(program, "leaves", leaves)
    set_uniform(program, "highest", len(surface.least) - 1)
    for name, values in (("least", surface.least), ("below", surface.below)):
        set_uniform(program, name, np.pad(values, (0, _HEIGHTS - len(values))).astype(np.float32))
    set_uniform(program, "parameters", surface.parameters.astype(np.float32))
    set_uniform(program, "table_shape", surface.table.shape[:3])


def _by_vertex(surface: Surface) -> Float32:
    """Normals and directions (n, 2, 4), each filled up to four numbers."""
    found = np.zeros((len(surface.normals), 2, 4), np.float32)
    found[:, 0, :3], found[:, 1, :3] = surface.normals, surface.toward_eye
    return found


def _split(sums: Float64) -> Float32:
    """Sums as float32 and what that leaves of them (leaves + 1, 2, 4): their differences keep the digits of float64."""
    found = np.zeros((len(sums), 2, 4), np.float32)
    found[:, 0, :3] = sums[:, :3]
    found[:, 1, :3] = sums[:, :3] - found[:, 0, :3]
    return found
