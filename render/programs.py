"""Shader sources with includes, and what the driver says about them in terms of file and line."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import moderngl
import numpy as np

from render.arrays import Float32
from render.errors import ShaderError

SHADERS = Path(__file__).parent / "shaders"
# A number, a vector, or float32 as they are written to the card: a matrix or an array of vectors.
Value = float | tuple[float, ...] | Float32
_DRAWING, _COMPUTING = "#version 330 core", "#version 430 core"
_INCLUDE = re.compile(r'^\s*#include\s+"([^"]+)"\s*$')
# Lines are numbered from a multiple of this, another one for each file: Mesa loses the source number of most errors.
_LINES_PER_FILE = 10_000
# Mesa writes 0:23(4), NVIDIA 0(23), others ERROR: 0:23.
_PLACE = re.compile(r"\b\d+(?::(\d+)(?:\(\d+\))?|\((\d+)\))")


@dataclass(frozen=True)
class Binding:
    """A material on the graphics card: its shader, and its textures and numbers by the names of the uniforms.

    `defines` are the names that the shader is compiled with: a kind of material may be several programs.
    """

    shader: str
    textures: Mapping[str, moderngl.Texture | moderngl.TextureArray]
    values: Mapping[str, Value] = field(default_factory=dict)
    defines: frozenset[str] = frozenset()

    def use(self, program: moderngl.Program, more: Mapping[str, moderngl.Texture] | None = None) -> None:
        """Bind every texture, also those that are not the material's, and set every uniform that the program kept."""
        bind(program, {**self.textures, **(more or {})})
        for name, value in self.values.items():
            set_uniform(program, name, value)

    def release(self) -> None:
        """Give the textures back."""
        for texture in self.textures.values():
            texture.release()


def bind(program: moderngl.Program, textures: Mapping[str, moderngl.Texture | moderngl.TextureArray]) -> None:
    """Bind textures that the program reads, each to a unit of its own."""
    read = {name: texture for name, texture in textures.items() if name in program}
    for unit, (name, texture) in enumerate(read.items()):
        texture.use(unit)
        set_uniform(program, name, unit)


def set_uniform(program: moderngl.Program | moderngl.ComputeShader, name: str, value: Value) -> None:
    """Set a uniform unless the linker has removed it because the shader's variant does not read it."""
    member = program.get(name, None)
    if not isinstance(member, moderngl.Uniform):
        return
    if isinstance(value, np.ndarray):
        # The linker may have cut the array after the last element that is read.
        member.write(np.ascontiguousarray(value).tobytes()[: 4 * member.array_length * member.dimension])
    else:
        member.value = value


def compile_program(
    context: moderngl.Context, vertex: str, fragment: str, defines: frozenset[str] = frozenset(), folder: Path = SHADERS
) -> moderngl.Program:
    """Compile and link two files of `folder`; raises ShaderError that names the file and the line."""
    files: list[str] = []
    sources = [_assemble(folder, name, defines, files, _DRAWING) for name in (vertex, fragment)]
    try:
        return context.program(vertex_shader=sources[0], fragment_shader=sources[1])
    except moderngl.Error as error:
        raise ShaderError(f"{vertex} + {fragment}: {_with_file_names(str(error), files)}") from error


def compile_compute(
    context: moderngl.Context, name: str, defines: frozenset[str] = frozenset(), folder: Path = SHADERS
) -> moderngl.ComputeShader:
    """The same for a compute shader, which OpenGL has from 4.3 on."""
    files: list[str] = []
    source = _assemble(folder, name, defines, files, _COMPUTING)
    try:
        return context.compute_shader(source)
    except moderngl.Error as error:
        raise ShaderError(f"{name}: {_with_file_names(str(error), files)}") from error


def _assemble(folder: Path, name: str, defines: frozenset[str], files: list[str], version: str) -> str:
    head = [version, *(f"#define {define}" for define in sorted(defines))]
    return "\n".join([*head, *_lines(folder, name, files, set())]) + "\n"


def _lines(folder: Path, name: str, files: list[str], seen: set[str]) -> list[str]:
    """The file's lines with `#include "name"` replaced by that file, once, and `#line` marks around it."""
    seen.add(name)
    try:
        text = (folder / name).read_text(encoding="utf-8")
    except OSError as error:
        raise ShaderError(f"{name}: the shader cannot be read: {error.strerror}") from error
    first = _LINES_PER_FILE * len(files) + 1
    files.append(name)
    lines = [f"#line {first}"]
    for number, line in enumerate(text.splitlines(), start=first):
        included = _INCLUDE.match(line)
        if included is None:
            lines.append(line)
        elif included[1] not in seen:
            lines += [*_lines(folder, included[1], files, seen), f"#line {number + 1}"]
        else:
            lines.append("")
    return lines


def _with_file_names(message: str, files: list[str]) -> str:
    """The errors of the driver's message with `file:line` in place of its numbers."""

    def named(place: re.Match[str]) -> str:
        file, line = divmod(int(place[1] or place[2]), _LINES_PER_FILE)
        return f"{files[file]}:{line}" if file < len(files) else place[0]

    wanted = [line.strip() for line in message.splitlines() if "error" in line.lower()]
    return "; ".join(_PLACE.sub(named, line) for line in wanted) or message.strip()
