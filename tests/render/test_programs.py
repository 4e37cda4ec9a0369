"""What is wrong with a shader is said with its file and line."""

from pathlib import Path

import pytest

from processing.products import ResidualBasis
from render.errors import ShaderError
from render.programs import SHADERS, compile_program

VERTEX = "in vec3 position;\nvoid main() { gl_Position = vec4(position, 1.0); }\n"
INCLUDED = "// one\n// two\nfloat broken() { return nothing; }\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "a.vert").write_text(VERTEX)
    return tmp_path


def test_error_names_file_and_line(gl, folder):
    (folder / "a.frag").write_text("out vec4 colour;\n\nvoid main() { colour = vec3(1.0); }\n")
    with gl.context, pytest.raises(ShaderError, match=r"a\.frag:3"):
        compile_program(gl.context, "a.vert", "a.frag", folder=folder)


def test_error_in_an_included_file_names_that_file(gl, folder):
    (folder / "part.glsl").write_text(INCLUDED)
    (folder / "a.frag").write_text(
        '\n\n#include "part.glsl"\nout vec4 colour;\nvoid main() { colour = vec4(broken()); }\n'
    )
    with gl.context, pytest.raises(ShaderError, match=r"part\.glsl:3"):
        compile_program(gl.context, "a.vert", "a.frag", folder=folder)


def test_line_numbers_go_on_after_an_include(gl, folder):
    (folder / "part.glsl").write_text("float whole() { return 1.0; }\n")
    (folder / "a.frag").write_text('#include "part.glsl"\n\nout vec4 colour;\nvoid main() { colour = whole(); }\n')
    with gl.context, pytest.raises(ShaderError, match=r"a\.frag:4"):
        compile_program(gl.context, "a.vert", "a.frag", folder=folder)


def test_error_in_the_vertex_shader_names_it(gl, folder):
    (folder / "b.vert").write_text("void main() {\n gl_Position = 1;\n}\n")
    (folder / "a.frag").write_text("out vec4 colour;\nvoid main() { colour = vec4(1.0); }\n")
    with gl.context, pytest.raises(ShaderError, match=r"b\.vert:2"):
        compile_program(gl.context, "b.vert", "a.frag", folder=folder)


def test_missing_shader_is_named(gl, folder):
    (folder / "a.frag").write_text('#include "absent.glsl"\n')
    with gl.context, pytest.raises(ShaderError, match=r"absent\.glsl: the shader cannot be read"):
        compile_program(gl.context, "a.vert", "a.frag", folder=folder)


@pytest.mark.parametrize("shader", sorted(path.name for path in SHADERS.glob("*.frag")))
@pytest.mark.parametrize("defines", [(), ("SHADOWS",), ("G_BUFFER",), ("GRADIENT_MAP",), ("G_BUFFER", "GRADIENT_MAP")])
def test_every_variant_of_every_shader_compiles(gl, shader, defines):
    own = {
        "srf.frag": ("BASIS_HALF",),
        "sbrdf.frag": ("LOBES 3",),
        "btf.frag": ("FOURS 1",),
        "mesostructure.frag": ("FOURS 1", "WRAPPED"),
        "layer.frag": ("WRAPPED",),
    }.get(shader, ())
    with gl.context:
        compile_program(gl.context, "surface.vert", shader, frozenset((*defines, *own))).release()


@pytest.mark.parametrize("defines", [(), ("G_BUFFER",), ("GRADIENT_MAP",), ("G_BUFFER", "GRADIENT_MAP")])
@pytest.mark.parametrize("lobes", [0, 3])
def test_shader_of_several_levels_compiles(gl, defines, lobes):
    own = ("LEVELS 7", f"LOBES {lobes}")
    with gl.context:
        compile_program(gl.context, "surface.vert", "sbrdf.frag", frozenset((*defines, *own))).release()


@pytest.mark.parametrize("basis", ResidualBasis)
def test_every_basis_compiles_on_the_sphere_of_a_capture(gl, basis):
    defines = frozenset({f"BASIS_{basis.name}", "ANISOTROPIC", "GRADIENT_MAP"})
    with gl.context:
        compile_program(gl.context, "surface.vert", "srf.frag", defines).release()


def test_basis_without_a_shader_is_an_error_that_says_so(gl):
    with gl.context, pytest.raises(ShaderError, match="no such basis"):
        compile_program(gl.context, "surface.vert", "srf.frag", frozenset({"BASIS_OF_ANOTHER_KIND"}))
