"""The texels of a skin while they are filled: patches are compared with what lies there, and blended in."""

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from processing.materials.skin_cut import share_within
from processing.materials.skin_example import CELL_TEXELS
from processing.materials.skin_patch import Sheet
from processing.materials.skin_turn import STEPS
from processing.products.arrays import Float32, Float64

FEATHER_TEXELS = 3.0  # over which a patch fades in, across the line that it is cut along
COVERED = 0.5  # a texel that is covered so far needs no patch of its own


class Canvas(NamedTuple):
    """Of every texel (t,): coefficients (t, 3 k), appearance (t, 4), how far it is covered, 0 to 1, by which patch."""

    value: Float32
    seen: Float32
    cover: Float64
    patch: NDArray[np.int32]


class Source(NamedTuple):
    """What patches are taken from: coefficients (h, w, 3 k), `seen` (3 k, 4), `turning` (STEPS, k, k)."""

    coefficients: Float32
    seen: Float64
    turning: Float64


def empty_canvas(source: Source, texels: int) -> Canvas:
    """Nothing covered."""
    coefficients, components = source.seen.shape
    return Canvas(
        np.zeros((texels, coefficients), np.float32),
        np.zeros((texels, components), np.float32),
        np.zeros(texels),
        np.full(texels, -1, np.int32),
    )


@numba.njit(cache=True)
def lying(canvas: Canvas, piece: Sheet, cells: int) -> tuple[Float64, Float64]:
    """Mean appearance (cells, cells, 4) of what lies in the patch, rows downward, and 1 where anything does."""
    total, count = np.zeros((cells, cells, canvas.seen.shape[1])), np.zeros((cells, cells))
    for k in range(len(piece.texel)):
        texel = piece.texel[k]
        if canvas.cover[texel] >= COVERED:
            column = int(np.floor(piece.xy[k, 0] / CELL_TEXELS + 0.5 * cells))
            row = int(np.floor(0.5 * cells - piece.xy[k, 1] / CELL_TEXELS))
            if 0 <= row < cells and 0 <= column < cells:
                count[row, column] += 1.0
                total[row, column] += canvas.seen[texel]
    return total / np.maximum(count, 1.0).reshape(cells, cells, 1), np.minimum(count, 1.0)


@numba.njit(cache=True)
def refined(canvas: Canvas, piece: Sheet, appearance: Float32, middle: tuple[float, float]) -> tuple[float, float]:
    """The middle (x, y) moved by up to a texel, in halves, to where it differs least from what lies in the patch."""
    stride = max(len(piece.texel) // 1000, 1)  # a thousand texels tell half a texel as well as all of them
    found, least = middle, np.inf
    there = np.empty(appearance.shape[2])
    for step in range(25):
        x, y = middle[0] + 0.5 * (step % 5 - 2), middle[1] + 0.5 * (step // 5 - 2)
        total = 0.0
        for k in range(0, len(piece.texel), stride):
            texel = piece.texel[k]
            if canvas.cover[texel] >= COVERED:
                sample(appearance, x + piece.xy[k, 0], y - piece.xy[k, 1], there)
                for component in range(len(there)):
                    total += (there[component] - canvas.seen[texel, component]) ** 2
        if total < least:
            found, least = (x, y), total
    return found


@numba.njit(cache=True)
def window(appearance: Float32, middle: tuple[float, float], cells: int) -> Float64:
    """The appearance of the example round `middle` (x, y), (cells, cells, 4)."""
    taken = np.empty((cells, cells, appearance.shape[2]))
    for row in range(cells):
        for column in range(cells):
            right, down = CELL_TEXELS * (column + 0.5 - 0.5 * cells), CELL_TEXELS * (row + 0.5 - 0.5 * cells)
            sample(appearance, middle[0] + right, middle[1] + down, taken[row, column])
    return taken


@numba.njit(cache=True)
def cut_in(
    canvas: Canvas, piece: Sheet, source: Source, middle: tuple[float, float], radii: Float64, number: int
) -> None:
    """Blend the example round `middle` into the texels within the line, as patch `number`."""
    k = source.turning.shape[1]
    there, turned = np.empty(3 * k), np.empty(3 * k)
    for at in range(len(piece.texel)):
        texel = piece.texel[at]
        share = share_within(piece.xy[at, 0], piece.xy[at, 1], radii, FEATHER_TEXELS)
        if share <= 0.0:
            continue
        sample(source.coefficients, middle[0] + piece.xy[at, 0], middle[1] - piece.xy[at, 1], there)
        turning = source.turning[int(np.round(piece.turn_rad[at] / (2.0 * np.pi) * STEPS)) % STEPS]
        for row in range(3 * k):
            turned[row] = 0.0
            for column in range(k):
                turned[row] += turning[row % k, column] * there[row - row % k + column]
        kept = (1.0 - share) * canvas.cover[texel]
        new = share / (share + kept)
        canvas.cover[texel] = share + kept
        canvas.seen[texel] = 0.0
        for row in range(3 * k):
            canvas.value[texel, row] += new * (turned[row] - canvas.value[texel, row])
            for component in range(canvas.seen.shape[1]):
                canvas.seen[texel, component] += canvas.value[texel, row] * source.seen[row, component]
        if new >= 0.5:
            canvas.patch[texel] = number


@numba.njit(cache=True)
def sample(image: Float32, x: float, y: float, value: Float64) -> None:
    """Bilinear lookup into `value` (c,) at a place in texels, the first one's centre at (0.5, 0.5); it repeats."""
    h, w, channels = image.shape
    left, top = np.floor(x - 0.5), np.floor(y - 0.5)
    fx, fy = x - 0.5 - left, y - 0.5 - top
    c0, r0 = int(left) % w, int(top) % h
    c1, r1 = (c0 + 1) % w, (r0 + 1) % h
    for c in range(channels):
        upper = (1.0 - fx) * image[r0, c0, c] + fx * image[r0, c1, c]
        lower = (1.0 - fx) * image[r1, c0, c] + fx * image[r1, c1, c]
        value[c] = (1.0 - fy) * upper + fy * lower
