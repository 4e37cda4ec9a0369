"""What has been compiled for the graphics card or written to it, the last few of each kind."""

import logging
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Protocol, TypeVar

import moderngl
import numpy as np

from render.arrays import Float32, Rows
from render.closed_mesh import is_closed
from render.materials import Material, upload
from render.mesh import Mesh
from render.programs import Binding, compile_program
from render.wrapping import wrapping

# Meshes and materials that stay on the card, each, and sets of images: a moving light redraws the same few.
_KEPT = 8
_KEPT_TARGETS = 12
_PLAIN = "3f 3f 4f 2f", "position", "normal", "tangent", "uv"
_WRAPPED = "2f 3f", "stretch", "bending"


_log = logging.getLogger(__name__)


class OnCard(Protocol):
    """Something that occupies memory of the card."""

    def release(self) -> None:
        """Give it back."""
        ...


Key = TypeVar("Key", bound=Hashable)
Held = TypeVar("Held", bound=OnCard)


@dataclass(frozen=True)
class _Geometry:
    """A mesh on the card."""

    mesh: Mesh
    vertices: moderngl.Buffer
    triangles: moderngl.Buffer

    def release(self) -> None:
        self.vertices.release()
        self.triangles.release()


@dataclass(frozen=True)
class _Wrapped:
    """How a mesh wraps samples."""

    mesh: Mesh
    vertices: moderngl.Buffer

    def release(self) -> None:
        self.vertices.release()


@dataclass(frozen=True)
class _Uploaded:
    """A material on the card; the material is held so that its identity stays its own."""

    material: Material
    binding: Binding

    def release(self) -> None:
        self.binding.release()


@dataclass(frozen=True)
class Target:
    """Images of float32, which shaders may read too, and a depth buffer; framebuffers that name some of them."""

    context: moderngl.Context
    images: tuple[moderngl.Texture, ...]
    depth: moderngl.Renderbuffer
    framebuffers: dict[tuple[bool, tuple[int, ...]], moderngl.Framebuffer]

    @property
    def whole(self) -> moderngl.Framebuffer:
        """All images and the depth buffer."""
        return self.some(*range(len(self.images)), deep=True)

    def some(self, *which: int, deep: bool = False) -> moderngl.Framebuffer:
        """The images that are named, in this order, without the depth buffer unless it is wanted."""
        key = deep, which
        if key not in self.framebuffers:
            attached = [self.images[number] for number in which]
            self.framebuffers[key] = self.context.framebuffer(attached, self.depth if deep else None)
        return self.framebuffers[key]

    def release(self) -> None:
        """Give all of it back."""
        held: list[OnCard] = [*self.framebuffers.values(), *self.images, self.depth]
        for each in held:
            each.release()


class Card:
    """Programs, meshes, materials and images of one context, which must be current in the calling thread."""

    def __init__(self, context: moderngl.Context) -> None:
        self.context = context
        self._programs: dict[tuple[str, str, frozenset[str]], moderngl.Program] = {}
        self._geometries: OrderedDict[int, _Geometry] = OrderedDict()
        self._wrapped: OrderedDict[int, _Wrapped] = OrderedDict()
        self._materials: OrderedDict[int, _Uploaded] = OrderedDict()
        self._targets: OrderedDict[tuple[str, tuple[int, int], tuple[int, ...]], Target] = OrderedDict()

    def program(self, vertex: str, fragment: str, defines: frozenset[str] = frozenset()) -> moderngl.Program:
        """The program of two shaders."""
        key = (vertex, fragment, defines)
        if key not in self._programs:
            self._programs[key] = compile_program(self.context, vertex, fragment, defines)
        return self._programs[key]

    def binding(self, material: Material) -> Binding:
        """The material's textures and numbers."""
        return keep(self._materials, id(material), lambda: _Uploaded(material, upload(self.context, material))).binding

    def draw(self, program: moderngl.Program, mesh: Mesh, *, wrapped: bool = False) -> None:
        """Draw the mesh, with how it wraps samples if that is asked for."""
        geometry = self._geometry(mesh)
        content: list[tuple[moderngl.Buffer | str, ...]] = [(geometry.vertices, *_PLAIN)]
        if wrapped:
            content.append((self._wrapping(mesh), *_WRAPPED))
        vertex_array = self.context.vertex_array(program, content, geometry.triangles, skip_errors=True)
        vertex_array.render()
        vertex_array.release()

    def fill(self, program: moderngl.Program) -> None:
        """Run a fragment shader for the whole window."""
        vertex_array = self.context.vertex_array(program, [])
        vertex_array.render(moderngl.TRIANGLES, vertices=3)
        vertex_array.release()

    def target(
        self, name: str, size: tuple[int, int], components: tuple[int, ...], *, whole_numbers: bool = False
    ) -> Target:
        """Images of so many components each, float32 or uint32, under a name that tells them from others."""

        def made() -> Target:
            kind = "u4" if whole_numbers else "f4"
            images = tuple(self.context.texture(size, count, dtype=kind) for count in components)
            for image in images:
                image.filter = (moderngl.NEAREST, moderngl.NEAREST)
                image.repeat_x = image.repeat_y = False
            return Target(self.context, images, self.context.depth_renderbuffer(size), {})

        return keep(self._targets, (name, size, components), made, _KEPT_TARGETS)

    def release(self) -> None:
        """Give everything back."""
        for kept in (self._geometries, self._wrapped, self._materials, self._targets):
            for held in kept.values():
                held.release()
            kept.clear()
        for program in self._programs.values():
            program.release()
        self._programs.clear()

    def _geometry(self, mesh: Mesh) -> _Geometry:
        def on_card() -> _Geometry:
            rows = np.hstack([mesh.positions, mesh.normals, mesh.tangents, mesh.uv])
            triangles = self.context.buffer(np.ascontiguousarray(mesh.triangles, dtype=np.int32).tobytes())
            return _Geometry(mesh, self._buffer(rows), triangles)

        return keep(self._geometries, id(mesh), on_card)

    def _wrapping(self, mesh: Mesh) -> moderngl.Buffer:
        def on_card() -> _Wrapped:
            wrap = wrapping(mesh)
            if not is_closed(mesh):
                _log.info("an open mesh has no silhouettes of its sample: it is drawn up to its own outline")
            return _Wrapped(mesh, self._buffer(np.hstack([wrap.stretch, wrap.bending])))

        return keep(self._wrapped, id(mesh), on_card).vertices

    def _buffer(self, rows: Rows) -> moderngl.Buffer:
        return self.context.buffer(rows.astype(np.float32).tobytes())


def by_columns(matrix: Rows) -> Float32:
    """A matrix as it is written to the card."""
    return matrix.T.astype(np.float32)


def keep(kept: OrderedDict[Key, Held], key: Key, make: Callable[[], Held], most: int = _KEPT) -> Held:
    """What is kept under the key, made if need be; beyond the limit, the one used longest ago is given back."""
    if key not in kept:
        kept[key] = make()
        if len(kept) > most:
            kept.popitem(last=False)[1].release()
    kept.move_to_end(key)
    return kept[key]
