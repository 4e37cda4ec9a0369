"""Fields and cuts where they are asked for: errors of fine fields without tracing all of their points."""

from dataclasses import replace

import numpy as np

from processing.lighting.cuts import Cuts
from processing.lighting.directions import SampleDirections
from processing.lighting.field import VisibilityField
from processing.lighting.rays import Occluder
from processing.lighting.self_visibility import self_visibility
from processing.lighting.shells import Shells
from processing.lighting.toggles import toggles_of
from processing.lighting.triangle_body import TriangleBody
from processing.products.arrays import Float64


def field_around(body: TriangleBody, sampled: SampleDirections, shells: Shells, points: Float64) -> VisibilityField:
    """The field of a body that is traced only at the sample points around `points` (n, 3)."""
    numbers, weights = shells.cells(points)
    asked = np.unique(numbers[weights > 0])
    occluder, changes = Occluder(body.vertices, body.triangles), []
    for number in asked:
        point = shells.points(number, number + 1)[0]
        toward = body.centre - point
        distance = float(np.linalg.norm(toward))
        cosine = np.sqrt(1 - (body.radius / distance) ** 2) - 1e-5 if distance > body.radius else -1.0
        inside = np.flatnonzero(sampled.directions @ toward >= cosine * distance)
        origins = np.broadcast_to(point.astype(np.float32), (len(inside), 3)).copy()
        visible = np.ones(len(sampled.directions), np.bool_)
        visible[inside] = ~occluder.blocks(origins, sampled.rays[inside])
        changes.append(toggles_of(visible))
    counts = np.zeros(len(shells), np.int64)
    counts[asked] = [len(change) for change in changes]
    toggles = np.concatenate([*changes, np.zeros(0, np.uint16)])
    return VisibilityField(shells, sampled.height, np.concatenate([[0], np.cumsum(counts)]), toggles)


def cuts_of(body: TriangleBody, sampled: SampleDirections, vertices: np.ndarray, tolerance: float) -> Cuts:
    """Cuts of some vertices; all others see nothing."""
    normals = np.zeros_like(body.normals)
    normals[vertices] = body.normals[vertices]
    return self_visibility(replace(body, normals=normals), sampled, tolerance)[0]
