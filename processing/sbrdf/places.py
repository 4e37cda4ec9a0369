"""Where the points of each view are seen from the top, by lobes and shadows that are known there.

Lobes and places take turns, each of which lowers the squared error, as k-means does (Lloyd 1982) with texels for
clusters. Left to the measured views alone, places would scatter: between the views their shifts are interpolated, and
mean shifts of places that have nothing in common lead to others that nobody chose. So a place costs the more, the
farther it is from where the neighbouring texels and views lead (iterated conditional modes, Besag 1986).
"""

import numpy as np
from numpy.typing import NDArray

from processing.products import DirectionMesh
from processing.products.arrays import Float32
from processing.sbrdf.flow_votes import Occlusion
from processing.sbrdf.places_kernel import nearest_of
from processing.sbrdf.samples import Samples
from processing.sbrdf.shaded_lobes import ShadedLobes
from processing.threads import in_parts

Ints = NDArray[np.int64]

_WINDOW = 2  # texels around a place, and around the point itself
_COHERENCE, _FAR = 4.0, 2.0  # cost of a place that is so many texels off, in the view's mean squared differences
_SIDES = ((0, 1), (1, 0), (0, -1), (-1, 0))
_AROUND = (*_SIDES, (1, 1), (1, -1), (-1, 1), (-1, -1))


def places(occlusion: Occlusion) -> Ints:
    """Texel of the top view (view, y * x) that each point of a view is seen at, -1 where hidden; the tile repeats."""
    views, height, width = occlusion.hidden.shape
    texel = _texels(np.rint(occlusion.shift).astype(np.int64)[..., None, :])[..., 0]
    return np.where(occlusion.hidden, -1, texel).reshape(views, height * width)


def moved(samples: Samples, occlusion: Occlusion, shaded: ShadedLobes) -> Occlusion:
    """The places, in whole texels, where lobes and shadows come near to what each view sees and neighbours agree.

    Looked at are those within two texels of the present place and of the point itself, and the four neighbours'. The
    top view's points and the hidden ones stay as they are.
    """
    shift, expected = occlusion.shift.copy(), _expected(samples, occlusion.shift)

    def move(view: int, _: int) -> None:
        if view != samples.top:
            better = _moved(samples, view, (occlusion.shift[view], expected[view]), shaded)
            shift[view] = np.where(occlusion.hidden[view, ..., None], shift[view], better)

    in_parts(move, len(shift), 1)
    return Occlusion(shift, occlusion.hidden, occlusion.hidden_ratio)


def _moved(samples: Samples, view: int, shifts: tuple[Float32, Float32], shaded: ShadedLobes) -> Float32:
    """Shift (y, x, 2) of one view, from the present and the expected one."""
    lights, _, height, width, _ = samples.shape
    seen = _vectors(samples.seen_from(view).reshape(lights, height * width, 3).swapaxes(0, 1))
    drawn = _vectors(shaded.seen_along(samples.light_directions, samples.view_directions[view]))
    candidates = _candidates(shifts[0])
    texels = _texels(candidates).reshape(height * width, -1)
    apart = np.nansum(np.square(seen - drawn[texels[:, 0]]), axis=1).mean()
    off = np.square(candidates - shifts[1][:, :, None]).sum(axis=3).reshape(texels.shape)
    extra = (_COHERENCE * apart * np.minimum(off / _FAR**2, 1)).astype(np.float32)
    chosen = np.empty(len(texels), np.int64)
    nearest_of(seen, drawn, texels, extra, chosen)
    return np.take_along_axis(candidates, chosen.reshape(height, width, 1, 1), axis=2)[:, :, 0].astype(np.float32)


def _candidates(shift: Float32) -> Ints:
    """Whole shifts (y, x, k, 2) to choose from, the present one first."""
    present = np.rint(shift).astype(np.int64)
    around = np.argwhere(np.ones((2 * _WINDOW + 1, 2 * _WINDOW + 1))) - _WINDOW
    near = (centre[:, :, None] + around for centre in (present, np.zeros_like(present)))
    sides = (np.roll(present, step, axis=(0, 1))[:, :, None] for step in _SIDES)
    return np.concatenate([present[:, :, None], *near, *sides], axis=2)


def _texels(shift: Ints) -> Ints:
    """Texel that shifts (..., y, x, k, 2), right and down, lead to."""
    height, width = shift.shape[-4:-2]
    rows, columns = np.mgrid[:height, :width][..., None]
    texel: Ints = (rows + shift[..., 1]) % height * width + (columns + shift[..., 0]) % width
    return texel


def _expected(samples: Samples, shift: Float32) -> Float32:
    """Mean of the mean shifts of the eight texels around and of the same texel in the neighbouring views."""
    around = sum(np.roll(shift, step, axis=(1, 2)) for step in _AROUND) / np.float32(len(_AROUND))
    beside = [shift[near].mean(axis=0) for near in _neighbours(samples)]
    return np.asarray((around + np.stack(beside)) / 2, np.float32)


def _neighbours(samples: Samples) -> list[list[int]]:
    """Views that share an edge of the mesh of directions with each view; itself where it has no edge."""
    near: list[set[int]] = [set() for _ in range(samples.shape[1])]
    for triangle in DirectionMesh.from_directions(samples.view_directions).triangles.tolist():
        for one in triangle:
            near[one] |= set(triangle) - {one}
    return [sorted(some) or [view] for view, some in enumerate(near)]


def _vectors(values: Float32) -> Float32:
    """(point, light, channel) as (point, light * channel), contiguous."""
    return np.ascontiguousarray(values).reshape(len(values), -1)
