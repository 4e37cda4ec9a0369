"""Light positions of photographs, .lp: a count, then on each line a picture's name and the direction of its light."""

from pathlib import Path

import numpy as np

from processing.errors import ImageError
from processing.products.arrays import Float64


def write_lp(path: Path, names: list[str], lights: Float64) -> None:
    """Write names and unit directions (n, 3): x right, y up the picture, z toward the camera."""
    lines = [f"{name} {x:.7f} {y:.7f} {z:.7f}" for name, (x, y, z) in zip(names, lights, strict=True)]
    path.write_text("\n".join([str(len(names)), *lines]) + "\n", encoding="utf-8")


def read_lp(path: Path) -> tuple[list[str], Float64]:
    """Names of pictures, as they are written, and unit directions (n, 3) of their lights.

    Positions of any length become directions; the count may be missing, names may hold blanks and folders.
    Raises ImageError that names the line where something is wrong, or a light lies behind the picture.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ImageError(f"{path}: not a readable list of lights ({error}).") from error
    numbered = [(number, line.split()) for number, line in enumerate(lines, 1) if line.strip()]
    stated = len(numbered) - 1
    if numbered and len(numbered[0][1]) == 1:
        first = numbered.pop(0)[1][0]
        stated = int(first) if first.isdecimal() else -1
    else:
        stated = len(numbered)
    names = [" ".join(words[:-3]) for _, words in numbered]
    lights = [_direction(path, number, words) for number, words in numbered]
    if stated != len(lights) or not lights:
        raise ImageError(f"{path}: says {stated} lights, but has {len(lights)}. Is the file whole?")
    return names, np.stack(lights)


def _direction(path: Path, number: int, words: list[str]) -> Float64:
    try:
        position = np.array([float(word) for word in words[-3:]])
        length = float(np.linalg.norm(position))
        if len(words) < 4 or not 0 < length < np.inf:
            raise ValueError("no direction")
    except ValueError as error:
        raise ImageError(f"{path}: line {number}: {' '.join(words)!r} is not a name and x, y, z of a light.") from error
    if position[2] <= 0:
        raise ImageError(f"{path}: line {number}: the light lies behind the picture; z is toward the camera.")
    return np.asarray(position / length, np.float64)
