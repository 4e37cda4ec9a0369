"""The studded tile of the documentation at a size of the test's own."""

import importlib.util
from pathlib import Path

EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "studded_btf.py"


def write_studs(folder: Path, size: int, rings: tuple[tuple[int, int], ...]) -> Path:
    """Its pictures, `size` pixels wide, from and under directions of `rings` (polar angle in degrees, count)."""
    spec = importlib.util.spec_from_file_location("studded_btf", EXAMPLE)
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    example.SIZE, example.RINGS = size, rings
    example.main(folder)
    return folder
