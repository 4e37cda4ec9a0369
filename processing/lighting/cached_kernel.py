"""Light past bodies that stand still: each vertex's visibility is one known step function (see `moving_kernel`)."""

from typing import Protocol

import numba
import numpy as np
from numpy.typing import NDArray

from processing.lighting.kept_steps import KeptSteps
from processing.lighting.lobe_nodes import Surface, room_for_nodes, write_nodes
from processing.lighting.moving_kernel import Steps
from processing.products.arrays import Float32, Float64
from processing.threads import in_parts

_PART = 256  # vertices that a thread takes at a time


class CachedFrame(Protocol):
    """What finds light past bodies that stand still: threads of the processor, or a graphics card."""

    def __call__(self, kept: KeptSteps, vertices: NDArray[np.int64], surface: Surface, sums: Float64) -> Float32:
        """Radiance (n, 3) of vertices (n,) that are all kept; `surface` is theirs, `sums` as in `cached_frame`."""
        ...


def frame_in_threads(kept: KeptSteps, vertices: NDArray[np.int64], surface: Surface, sums: Float64) -> Float32:
    """A `CachedFrame` of the processor."""
    steps, found = kept.steps(vertices), np.empty((len(vertices), 3), np.float32)

    def work(start: int, stop: int) -> None:
        part = slice(start, stop)
        there = surface._replace(lit=surface.lit[part], seen=surface.seen[part])
        cached_frame(Steps(steps.begin[part], steps.end[part], steps.start, steps.value), there, sums, found[part])

    in_parts(work, len(vertices), _PART)
    return found


@numba.njit(nogil=True, cache=True)
def cached_frame(steps: Steps, surface: Surface, sums: Float64, radiance: Float32) -> None:
    """Write the radiance (n, 3) of vertices; `sums` (leaves + 1, 4) are the light's before each leaf."""
    leaves = len(sums) - 1
    nodes = room_for_nodes(leaves, surface.heights)
    node_start, node_f = nodes.start, nodes.value
    for i in range(len(radiance)):
        if surface.kind == 0:
            _even_light(steps, i, surface, sums, radiance[i])
            continue
        count = write_nodes(surface, i, nodes)
        k, end = steps.begin[i], steps.end[i]
        x, y, z = 0.0, 0.0, 0.0
        for node in range(count):
            at, stop = int(node_start[node]), int(node_start[node + 1])
            a, b, c = 0.0, 0.0, 0.0
            while at < stop:
                after = int(steps.start[k + 1]) if k + 1 < end else leaves
                until = min(after, stop)
                value = steps.value[k]
                a += value * (sums[until, 0] - sums[at, 0])
                b += value * (sums[until, 1] - sums[at, 1])
                c += value * (sums[until, 2] - sums[at, 2])
                at = until
                if after <= stop:
                    k += 1
            x += a * node_f[node, 0]
            y += b * node_f[node, 1]
            z += c * node_f[node, 2]
        radiance[i, 0], radiance[i, 1], radiance[i, 2] = x, y, z


@numba.njit(nogil=True, cache=True, fastmath={"contract"})
def _even_light(steps: Steps, i: int, surface: Surface, sums: Float64, radiance: Float32) -> None:
    """The same where reflectance is one value for all directions: each step is a drop from the last one."""
    x, y, z, before = 0.0, 0.0, 0.0, 0.0
    for k in range(steps.begin[i], steps.end[i]):
        leaf, value = steps.start[k], steps.value[k]
        drop = before - value
        x += drop * sums[leaf, 0]
        y += drop * sums[leaf, 1]
        z += drop * sums[leaf, 2]
        before = value
    end = len(sums) - 1
    radiance[0] = (x + before * sums[end, 0]) * surface.parameters[0]
    radiance[1] = (y + before * sums[end, 1]) * surface.parameters[1]
    radiance[2] = (z + before * sums[end, 2]) * surface.parameters[2]
