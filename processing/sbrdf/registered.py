"""What all views see of the points that are seen from the top, gathered; lobes and places that fit each other.

With the shifts known, the samples of one surface point lie together, and its lobes and shadows need no longer follow
what passes by its texel. And with better lobes some points find better places: both in turns, each of which lowers the
squared error, as k-means does (Lloyd 1982), with texels for clusters.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from processing.products.arrays import Float32
from processing.sbrdf.flow_votes import Occlusion
from processing.sbrdf.places_kernel import gather_view, nearest_of
from processing.sbrdf.samples import Samples
from processing.sbrdf.shaded_lobes import ShadedLobes, Views, fit_shaded
from processing.threads import in_parts

Ints = NDArray[np.int64]

_GAIN = 0.02  # of the squared error, for which a point leaves its place
_VALUES = 1 << 26  # gathered at a time: 256 MiB
_WINDOW = 2  # texels around a place, and around the point itself
_LIGHTS, _POINTS = 4, 256  # that a thread takes at a time


def places(occlusion: Occlusion) -> Ints:
    """Texel of the top view (view, y * x) that each point of a view is seen at, -1 where hidden; the tile repeats."""
    views, height, width = occlusion.hidden.shape
    rows, columns = np.mgrid[:height, :width]
    right, down = np.moveaxis(np.rint(occlusion.shift).astype(np.int64), -1, 0)
    texel = (rows + down) % height * width + (columns + right) % width
    return np.where(occlusion.hidden, -1, texel).reshape(views, -1)


def texel_blocks(samples: Samples, most: int = _VALUES) -> Iterator[slice]:
    """Spans of texels of the top view whose samples are at most so many values."""
    lights, views, height, width, channels = samples.shape
    step = max(most // (lights * views * channels), 1)
    return (slice(start, min(start + step, height * width)) for start in range(0, height * width, step))


def gathered(samples: Samples, place: Ints, some: slice) -> Views:
    """What each view sees of some texels: the mean over the points that it has at one, which count so many times."""
    lights, views, height, width, _ = samples.shape
    total = np.zeros((some.stop - some.start, lights, views, 3), np.float32)
    count = np.zeros(total.shape[:3], np.float32)
    for view in range(views):
        mine = place[view] - some.start
        mine = np.where((place[view] >= some.start) & (place[view] < some.stop), mine, -1)
        if not (mine >= 0).any():
            continue
        seen = samples.seen_from(view).reshape(lights, height * width, 3)

        def part(first: int, stop: int, seen: Float32 = seen, mine: Ints = mine, view: int = view) -> None:
            gather_view(seen[first:stop], mine, total[:, first:stop, view], count[:, first:stop, view])

        in_parts(part, lights, _LIGHTS)
    total /= np.maximum(count, 1)[..., None]
    return Views(total, count, samples.light_directions, samples.view_directions)


def refit(samples: Samples, occlusion: Occlusion, shaded: ShadedLobes, rounds: int) -> ShadedLobes:
    """Lobes and shadows of the points seen from the top, fitted to what all views see of them."""
    place = places(occlusion)
    found = []
    for some in texel_blocks(samples):
        seen = gathered(samples, place, some)
        found.append(fit_shaded(seen, shaded.lobes.chosen(some), rounds))
    return ShadedLobes.joined(found)


def moved(samples: Samples, occlusion: Occlusion, shaded: ShadedLobes) -> Occlusion:
    """The places near the present ones where lobes and shadows come nearest to what each view sees, in whole texels.

    Looked at are the places within two texels of the present one, of the neighbours' and of none. The top view's points
    and the hidden ones stay as they are.
    """
    shift = occlusion.shift.copy()
    for view in range(len(shift)):
        if view == samples.top:
            continue
        better = _moved(samples, view, occlusion, shaded)
        shift[view] = np.where(occlusion.hidden[view, ..., None], shift[view], better)
    return Occlusion(shift, occlusion.hidden, occlusion.hidden_ratio)


def _moved(samples: Samples, view: int, occlusion: Occlusion, shaded: ShadedLobes) -> Float32:
    """Shift (y, x, 2) of one view."""
    lights, _, height, width, _ = samples.shape
    seen = _vectors(samples.seen_from(view).reshape(lights, height * width, 3).swapaxes(0, 1))
    drawn = _vectors(shaded.seen_along(samples.light_directions, samples.view_directions[view]))
    shifts = _candidates(occlusion.shift[view])
    rows, columns = np.mgrid[:height, :width]
    texels = (rows[..., None] + shifts[..., 1]) % height * width + (columns[..., None] + shifts[..., 0]) % width
    texels, chosen = texels.reshape(height * width, -1), np.empty(height * width, np.int64)

    def part(first: int, stop: int) -> None:
        nearest_of(seen[first:stop], drawn, texels[first:stop], _GAIN, chosen[first:stop])

    in_parts(part, len(seen), _POINTS)
    return np.take_along_axis(shifts, chosen.reshape(height, width, 1, 1), axis=2)[:, :, 0].astype(np.float32)


def _candidates(shift: Float32) -> Ints:
    """Whole shifts (y, x, k, 2), the present one first."""
    present = np.rint(shift).astype(np.int64)
    around = np.argwhere(np.ones((2 * _WINDOW + 1, 2 * _WINDOW + 1))) - _WINDOW
    near = (centre[:, :, None] + around for centre in (present, np.zeros_like(present)))
    sides = [np.roll(present, step, axis)[:, :, None] for axis in (0, 1) for step in (-1, 1)]
    return np.concatenate([present[:, :, None], *near, *sides], axis=2)


def _vectors(values: Float32) -> Float32:
    """(point, light, channel) as (point, light * channel), contiguous."""
    return np.ascontiguousarray(values).reshape(len(values), -1)
