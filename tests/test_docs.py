"""What the documentation says is so: its commands run, its names exist, its examples work."""

import importlib
import os
import re
import shutil
import subprocess
import sys
import types
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import typer

from processing.errors import ProcessingError
from render import materials, on_card
from render.comparison import gl_vs_reference
from render.errors import GlUnavailableError
from render.opengl import GlRenderer
from render.programs import SHADERS, compile_program
from render.shapes import sphere
from rig.errors import RigError
from service.cli import app
from service.demo import FIGURES
from service.problems import EXIT_CODES, PROBLEMS, UNUSABLE_FILE

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
PACKAGES = ("rig", "processing", "render", "service", "simulators", "tests")
BLOCK = re.compile(r"(?:<!-- (?P<note>[^\n]+) -->\n)?```(?P<language>\w+)\n(?P<code>.*?)```", re.DOTALL)
FILE_ENDINGS = (".toml", ".json", ".md", ".py")
PLACEHOLDER = re.compile(r"NAME|FOLDER|[*<]")


def page_name(path):
    return path.name


def blocks(page, language):
    return [match for match in BLOCK.finditer(page.read_text()) if match["language"] == language]


def quoted(page):
    """What stands in backticks outside of blocks."""
    return re.findall(r"`([^`\n]+)`", BLOCK.sub("", page.read_text()))


def commands(page):
    """Every `rig ...` of a page, in its blocks and in its text."""
    lines = [line for block in blocks(page, "sh") for line in block["code"].splitlines()]
    return [text for text in [*lines, *quoted(page)] if text.startswith("rig ")]


@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p, "sh")], ids=page_name)
@pytest.mark.timeout(400)  # a capture, its products and pictures, step after step
def test_every_command_runs(page, tmp_path):
    """In one folder, in the page's order; a block that cannot be run says why in a comment above it."""
    (tmp_path / "docs").symlink_to(ROOT / "docs")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    for block in blocks(page, "sh"):
        if block["note"] is not None:
            assert re.fullmatch(r"not run: \S.*", block["note"])
            continue
        script = ["bash", "-euo", "pipefail", "-c", block["code"]]
        done = subprocess.run(
            script, cwd=tmp_path, env=os.environ | {"PATH": path}, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"{block['code']}\n{done.stdout}\n{done.stderr}"


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_every_command_and_option_exists(page):
    known = typer.main.get_command(app).commands
    for text in commands(page):
        name, *words = text.split()[1:]
        assert name in known, text
        options = {option for parameter in known[name].params for option in (*parameter.opts, "--help")}
        assert {word for word in words if word.startswith("-")} <= options, text


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_every_make_target_exists(page):
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    lines = [line for block in blocks(page, "sh") for line in block["code"].splitlines()]
    named = {text.split()[1] for text in [*lines, *quoted(page)] if text.startswith("make ")}
    assert named <= targets


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_every_file_and_link_exists(page):
    missing = []
    for text in quoted(page):
        top = text.split("/")[0]
        if "/" in text and " " not in text and top in (*PACKAGES, "docs") and not PLACEHOLDER.search(text):
            missing += [] if (ROOT / text).exists() else [text]
    for target in re.findall(r"\]\(([^)#]+)", page.read_text()):
        missing += [] if (page.parent / target).exists() else [target]
    assert not missing


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_every_name_exists(page):
    for text in quoted(page):
        if re.fullmatch(rf"(?:{'|'.join(PACKAGES)})(?:\.\w+)+", text) and not text.endswith(FILE_ENDINGS):
            assert resolved(text) is not None, text


def resolved(dotted):
    """The module or what is in it."""
    parts = dotted.split(".")
    for count in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        for name in parts[count:]:
            found = getattr(found, name)  # raises AttributeError with the name that is wrong
        return found
    return None


@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p, "python")], ids=page_name)
def test_every_python_example_runs(page, monkeypatch):
    monkeypatch.chdir(ROOT)
    for block in blocks(page, "python"):
        exec(compile(block["code"], str(page), "exec"), {"__name__": "example"})


@pytest.fixture
def velvet(tmp_path, monkeypatch):
    """The example material as the page writes it, where the page says that its files go."""
    files = {b["note"].removeprefix("file: "): b["code"] for b in _files(ROOT / "docs/add-a-material.md")}
    folder = shutil.copytree(SHADERS, tmp_path / "shaders")
    (folder / "velvet.frag").write_text(files["render/shaders/velvet.frag"])
    module = types.ModuleType("render.velvet")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    exec(compile(files["render/velvet.py"], "render/velvet.py", "exec"), module.__dict__)
    monkeypatch.setitem(materials._MODULES, module.Velvet, module)
    monkeypatch.setattr(on_card, "compile_program", partial(compile_program, folder=folder))
    return module.Velvet((0.4, 0.05, 0.1), 0.5)


def _files(page):
    return [b for b in BLOCK.finditer(page.read_text()) if (b["note"] or "").startswith("file: ")]


def test_the_example_material_is_drawn_alike_by_shader_and_numpy(velvet):
    try:
        renderer = GlRenderer()
    except GlUnavailableError as error:
        pytest.skip(str(error))
    try:
        assert gl_vs_reference(velvet, sphere(), size=(96, 96), renderer=renderer) <= 1e-3
    finally:
        renderer.release()


def test_the_example_material_has_a_rim(velvet):
    """A matt surface looks alike from everywhere; velvet is brighter where the view grazes."""
    straight, grazing = np.array([[0.0, 0.0, 1.0]]), np.array([[0.8, 0.0, 0.6]])
    middle, rim = (materials.outgoing(velvet, np.zeros((1, 2)), straight, view) for view in (straight, grazing))
    assert (rim > middle).all()


def test_the_readme_names_every_figure_of_the_demo():
    named = re.findall(r"^\| `(\w+)` \|", (ROOT / "README.md").read_text(), re.MULTILINE)
    assert named[0] == "wall_s"
    assert sorted(named[1:]) == sorted(FIGURES)


def test_the_readme_names_every_command():
    page = (ROOT / "README.md").read_text()
    for name in typer.main.get_command(app).commands:
        assert f"rig {name}" in page, name


def test_the_page_of_errors_is_the_table_of_the_program():
    page = (ROOT / "docs/errors.md").read_text()
    exits = re.findall(r"^\| (\d+) \| (.+) \|$", page, re.MULTILINE)
    assert {int(code): meaning for code, meaning in exits} == EXIT_CODES
    told = re.findall(r"^\| `([a-z-]+)` \| (\d+) \| (\d+) \|", page, re.MULTILINE)
    assert len({code for code, *_ in told}) == len(told)
    known = {(p.code, str(p.exit_code), str(p.status)) for p in [*PROBLEMS.values(), UNUSABLE_FILE]}
    assert set(told) == known


@pytest.mark.parametrize("root", [RigError, ProcessingError])
def test_every_error_has_a_code(root):
    """Also one that is added later, by its ancestry."""
    assert root in PROBLEMS
