"""What the paper's merge reads at a vertex: its own cut, and those that tell what the other bodies hide from it."""

from collections.abc import Sequence

import numpy as np

from processing.lighting.cuts import Cuts
from processing.lighting.directions import SampleDirections
from processing.lighting.field import VisibilityField
from processing.lighting.surroundings import AT_VERTEX, HIDDEN, Neighbour, RelitBody, exact_weights
from processing.lighting.toggles import binary_cuts
from processing.products.arrays import Float64


def merge_operands(
    bodies: Sequence[RelitBody],
    places: Sequence[Float64],
    sampled: SampleDirections,
    number: int,
    vertex: int,
    *,
    fields_alone: bool = False,
) -> tuple[np.ndarray, ...]:
    """Heights, values, first and last nodes, groups and weights of `tests.reference.merge.merged` at a body's vertex.

    Bodies are moved to `places` (3,) and not turned. With `fields_alone` fields tell of close bodies too, as in the
    paper.
    """
    one = bodies[number]
    cuts, weight, group = [_part(one.self_visibility, vertex)], [1.0], [0]
    point, normal = one.body.origins[vertex : vertex + 1], one.body.normals[vertex : vertex + 1]
    for k, other in enumerate(bodies):
        if k != number:
            near = Neighbour(other, np.eye(3), places[k] - places[number], sampled)
            found = _cuts_past(near, point, normal, fields_alone=fields_alone)
            cuts += [cut for cut, _ in found]
            weight += [share for _, share in found]
            group += [group[-1] + 1] * len(found)
    ends = np.cumsum([0, *(len(cut.heights) for cut in cuts)])
    heights, values = np.concatenate([cut.heights for cut in cuts]), np.concatenate([cut.values for cut in cuts])
    return heights, values, ends[:-1], ends[1:], np.array(group), np.array(weight)


def _cuts_past(near: Neighbour, point: Float64, normal: Float64, *, fields_alone: bool) -> list[tuple[Cuts, float]]:
    """A body's cuts at the sample points around a vertex with their weights, or at the vertex itself."""
    (told,) = near.reached(point, normal)
    field = near.relit.field
    if told == HIDDEN:
        return []
    if not isinstance(field, VisibilityField) or (told == AT_VERTEX and not fields_alone):
        counts, toggles = near.changes(point, normal)
        return [(binary_cuts(np.array([0, counts[0]]), toggles, near.sampled.height), 1.0)]
    numbers, weights = field.cells(point - near.shift)
    shares = exact_weights(weights)[0]
    return [(field.cuts(numbers[0, k : k + 1]), float(shares[k])) for k in np.flatnonzero(shares)]


def _part(cuts: Cuts, number: int) -> Cuts:
    part = slice(cuts.first[number], cuts.first[number + 1])
    return Cuts(np.array([0, part.stop - part.start]), cuts.heights[part], cuts.values[part])
