"""Light past bodies that stand still: each vertex's visibility is one known step function (see `moving_kernel`)."""

import numba

from processing.lighting.moving_kernel import Steps, Surface, room_for_nodes, write_nodes
from processing.products.arrays import Float32, Float64


@numba.njit(nogil=True, cache=True)
def cached_frame(steps: Steps, surface: Surface, sums: Float64, radiance: Float32) -> None:
    """Write the radiance (n, 3) of vertices; `sums` (leaves + 1, 4) are the light's before each leaf."""
    leaves = len(sums) - 1
    nodes = room_for_nodes(leaves)
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
