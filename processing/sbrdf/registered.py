"""Lobes and shadows of the points that are seen from the top, fitted to what all views see of them.

With the shifts known, the samples of one surface point lie together, and its lobes and shadows need no longer follow
whatever passes by its texel.
"""

from collections.abc import Iterator

import numpy as np

from processing.products.arrays import Float32
from processing.sbrdf.flow_votes import Occlusion
from processing.sbrdf.places import Ints, places
from processing.sbrdf.places_kernel import gather_view
from processing.sbrdf.samples import Samples
from processing.sbrdf.shaded_lobes import ShadedLobes, Views, fit_shaded
from processing.threads import in_parts

# How much a texel's own sample counts beside one of its point: lobes would run wild between the directions of views
# that see none of its points.
_OWN = 0.1
_VALUES = 1 << 26  # gathered at a time: 256 MiB
_LIGHTS = 4  # that a thread takes at a time


def refit(samples: Samples, occlusion: Occlusion, shaded: ShadedLobes, rounds: int) -> ShadedLobes:
    """Lobes and shadows again, from those that there are, each texel's from what all views see of its point."""
    place = places(occlusion)
    blocks = _blocks(samples)
    found = [fit_shaded(gathered(samples, place, some), shaded.lobes.chosen(some), rounds) for some in blocks]
    return ShadedLobes.joined(found)


def gathered(samples: Samples, place: Ints, some: slice) -> Views:
    """What each view sees of some texels' points: the mean over the points of the view that `places` leads there.

    They count 1 each, and the texel's own sample a tenth beside them.
    """
    lights, views, height, width, _ = samples.shape
    total, count = _own(samples, some)
    for view in range(views):
        mine = place[view] - some.start
        mine = np.where((place[view] >= some.start) & (place[view] < some.stop), mine, -1)
        seen = samples.seen_from(view).reshape(lights, height * width, 3)

        def part(first: int, stop: int, seen: Float32 = seen, mine: Ints = mine, view: int = view) -> None:
            gather_view(seen[first:stop], mine, total[:, first:stop, view], count[:, first:stop, view])

        in_parts(part, lights, _LIGHTS)
    total /= np.maximum(count, _OWN)[..., None]
    return Views(total, count, samples.light_directions, samples.view_directions)


def _blocks(samples: Samples) -> Iterator[slice]:
    """Spans of texels of the top view."""
    lights, views, height, width, channels = samples.shape
    step = max(_VALUES // (lights * views * channels), 1)
    return (slice(start, min(start + step, height * width)) for start in range(0, height * width, step))


def _own(samples: Samples, some: slice) -> tuple[Float32, Float32]:
    """The texels' own samples, as much as they count, and that: (t, light, view, 3) and (t, light, view)."""
    width = samples.shape[3]
    own = np.empty((some.stop - some.start, *samples.shape[:2], 3), np.float32)
    weight = np.empty(own.shape[:3], np.float32)
    spans = list(samples.row_spans())

    def fill(number: int, _: int) -> None:
        rows = spans[number]
        first, stop = max(rows.start * width, some.start), min(rows.stop * width, some.stop)
        if first >= stop:
            return
        values = samples.texels(rows)[first - rows.start * width : stop - rows.start * width]
        for texel, found in enumerate(values.reshape(-1, *own.shape[1:]), first - some.start):
            known = np.isfinite(found[..., 0] + found[..., 1] + found[..., 2])
            weight[texel] = known * np.float32(_OWN)
            own[texel] = np.where(known[..., None], found * np.float32(_OWN), 0)

    in_parts(fill, len(spans), 1)
    return own, weight
