"""Fields and cuts where they are asked for: errors of fine fields without tracing all of their points."""

from dataclasses import replace

import numpy as np

from processing.lighting.cuts import Cuts
from processing.lighting.directions import SampleDirections
from processing.lighting.field import VisibilityField
from processing.lighting.self_visibility import self_visibility
from processing.lighting.shells import Shells
from processing.lighting.tracing import BodyTracer, leaf_rays
from processing.lighting.triangle_body import TriangleBody
from processing.products.arrays import Float64
from processing.threads import in_parts


def field_around(body: TriangleBody, sampled: SampleDirections, shells: Shells, points: Float64) -> VisibilityField:
    """The field of a body that is traced only at the sample points around `points` (n, 3)."""
    numbers, weights = shells.cells(points)
    asked = np.unique(numbers[weights > 0])
    tracer, leaves = BodyTracer(body), leaf_rays(sampled)

    def work(start: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
        some = np.concatenate([shells.points(number, number + 1) for number in asked[start:stop]])
        counts, toggles, _ = tracer.changes(some, np.zeros_like(some), leaves)
        return counts, toggles

    counts, parts = np.zeros(len(shells), np.int64), in_parts(work, len(asked), 64)
    counts[asked] = np.concatenate([np.zeros(0, np.int64), *(part[0] for part in parts)])
    toggles = np.concatenate([np.zeros(0, np.uint16), *(part[1] for part in parts)])
    return VisibilityField(shells, sampled.height, np.concatenate([[0], np.cumsum(counts)]), toggles)


def cuts_of(body: TriangleBody, sampled: SampleDirections, vertices: np.ndarray, tolerance: float) -> Cuts:
    """Cuts of some vertices; all others see nothing."""
    normals = np.zeros_like(body.normals)
    normals[vertices] = body.normals[vertices]
    return self_visibility(replace(body, normals=normals), sampled, tolerance)[0]
