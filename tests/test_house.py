"""The house rules that a program can check: budgets, walls, byte vectors that both sides read."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("rig", "processing", "render", "service", "simulators")
MODULES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
MODULE_LINES, FUNCTION_LINES = 400, 60


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def imported_modules(path: Path) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return names


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_modules_and_functions_stay_readable(path):
    tree = ast.parse(path.read_text())
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
    too_long = [f.name for f in functions if f.end_lineno - f.lineno + 1 > FUNCTION_LINES]
    assert not too_long
    assert len(path.read_text().splitlines()) <= MODULE_LINES


@pytest.mark.parametrize("path", [p for p in MODULES if p.is_relative_to(ROOT / "render")], ids=name_of)
def test_render_knows_only_the_products_of_processing(path):
    ours = {name for name in imported_modules(path) if name.split(".")[0] in PACKAGES}
    assert all(name.startswith(("render", "processing.products")) or name == "processing" for name in ours), ours


def test_only_one_module_of_the_rig_waits():
    waiting = [name_of(p) for p in MODULES if p.is_relative_to(ROOT / "rig") and "time.sleep(" in p.read_text()]
    assert waiting == ["rig/drivers/clock.py"]


@pytest.mark.parametrize("vectors", sorted((ROOT / "tests/vectors").glob("*.toml")), ids=lambda path: path.stem)
def test_byte_vectors_are_read_by_both_sides(vectors):
    """A wire format that only one side checks against its source could be wrong in both in the same way."""
    for side in ("rig", "simulators"):
        sources = "".join(path.read_text() for path in (ROOT / "tests" / side).rglob("*.py"))
        assert vectors.name in sources or f'"{vectors.stem}"' in sources, f"{side} does not read {vectors.name}"
