"""Visibility cuts of a furnished room: how large they are in each code, and how long they take.

`vcf_height_over_index`: bytes of the fields' cuts with 4 bits of height and 1 of value, over those with a node's number
of 16 bits and 1 of value; both are written. `all_height_over_index`: the same of fields and vertices' cuts, where the
latter have two bytes of value beside 4 bits of height or 16 of number; rows have other sizes, among them the 8 bytes in
either form that the paper's 270 and 687 MB tell. `disk_bits_per_node`: of the fields' files. `mean_cut_svc`,
`mean_cut_vcf`: nodes of a cut; the paper has 428 and 710. `precompute_s`, `precompute_mrays_per_s`: all cuts and
fields with all threads, and the rays among them; bodies of one shape are computed once. Every code is read back and
compared on one sphere of each field.
"""

from collections.abc import Iterator

import numpy as np

from processing.lighting import coding
from processing.lighting.cuts import Cuts
from processing.lighting.directions import sample_directions
from processing.lighting.field import VisibilityField, block_size
from processing.lighting.precomputation import cached_field, cached_self_visibility
from processing.lighting.shells import ShellPlan
from processing.lighting.toggles import binary_cuts
from service.bench import Result
from tests.benchmarks.yardsticks.furniture import (
    FULL,
    QUICK,
    PrecomputedPiece,
    furniture,
    precomputed_furniture,
    scratch,
)

NODE_BYTES = 2.5, 4.0  # of a vertex's cut by height and by index
OTHER_NODE_BYTES = {
    "8 and 8 bytes, the paper's": (8.0, 8.0),
    "height and two bytes, 8 bytes": (2.5, 8.0),
    "height and float, number and float": (4.5, 6.0),
}

Row = dict[str, object]


def run(*, quick: bool) -> Result:
    """The room of 27 000 vertices with fields of 32 x 6 x 32 x 32 points, or of 2000 with 8 x 6 x 8 x 8."""
    plan, vertices = ShellPlan(8 if quick else 32), QUICK if quick else FULL
    _compile()
    pieces = precomputed_furniture(vertices, plan)
    shapes = list({piece.piece.body: piece for piece in pieces}.values())
    rows = [*_directions(), *(row for piece in shapes for row in _costs(piece, plan))]
    fields = [piece.field for piece in shapes if isinstance(piece.field, VisibilityField)]
    sizes = [_field_sizes(field) for field in fields]
    by_height, by_index, nodes = (sum(size[k] for size in sizes) for k in range(3))
    vertex_nodes = sum(len(piece.self_visibility.heights) for piece in pieces)
    rows += list(_forms(by_height, by_index, vertex_nodes))
    costs = [cost for piece in shapes for cost in (piece.cuts_cost, piece.field_cost) if cost is not None]
    seconds = sum(cost.seconds for cost in costs)
    figures = {
        "vcf_height_over_index": by_height / by_index,
        "all_height_over_index": _over(by_height, by_index, vertex_nodes, *NODE_BYTES),
        "disk_bits_per_node": 8 * sum(piece.field_cost.disk_bytes for piece in shapes if piece.field_cost) / nodes,
        "mean_cut_svc": vertex_nodes / sum(len(piece.self_visibility) for piece in pieces),
        "mean_cut_vcf": nodes / sum(len(field.shells) for field in fields),
        "precompute_s": seconds,
        "precompute_mrays_per_s": sum(cost.rays for cost in costs) / seconds / 1e6,
    }
    return Result(figures, rows)


def _compile() -> None:
    """The compiler's time is not the method's."""
    body, sampled = furniture(100)[1].body, sample_directions(4)
    cached_self_visibility(body, sampled, scratch())
    cached_field(body, sampled, scratch(), shells=ShellPlan(2))


def _directions() -> Iterator[Row]:
    sampled = sample_directions()
    yield {"method": "repelled directions", "directions": len(sampled.directions),
           "solid_angle_deviation": sampled.unevenness, "cap_discrepancy": sampled.cap_discrepancy}  # fmt: skip


def _costs(piece: PrecomputedPiece, plan: ShellPlan) -> Iterator[Row]:
    name, cuts, cost = piece.piece.name, piece.self_visibility, piece.cuts_cost
    yield {"method": "SVC", "size": f"{name}, {len(cuts)} vertices", "mean_cut": cuts.mean_size, "rays": cost.rays,
           "time_s": cost.seconds, "mrays_per_s": cost.rays / cost.seconds / 1e6, "disk_bytes": cost.disk_bytes,
           "disk_bits_per_node": 8 * cost.disk_bytes / len(cuts.heights)}  # fmt: skip
    if isinstance(piece.field, VisibilityField) and piece.field_cost is not None:
        field, cost = piece.field, piece.field_cost
        every = len(field.shells) << field.height
        yield {"method": "VCF", "size": f"{name}, {len(field.shells)} points, {plan.spacing} spheres",
               "mean_cut": field.mean_cut, "rays": cost.rays, "traced_share": cost.rays / every,
               "time_s": cost.seconds, "mrays_per_s": cost.rays / cost.seconds / 1e6, "disk_bytes": cost.disk_bytes,
               "memory_bytes": field.toggles.nbytes + field.first.nbytes}  # fmt: skip


def _field_sizes(field: VisibilityField) -> tuple[int, int, int]:
    """Bytes by height and by index, and nodes, sphere by sphere; codes of the first one are read back."""
    by_height, by_index, nodes, step = 0, 0, 0, block_size(field.shells)
    for start in range(0, len(field.shells), step):
        bounds = field.first[start : start + step + 1]
        cuts = binary_cuts(bounds - bounds[0], field.toggles[bounds[0] : bounds[-1]], field.height)
        codes = coding.height_form(cuts), coding.index_form(cuts, field.height)
        if start == 0:
            _check(cuts, *codes, field.height)
        by_height, by_index, nodes = by_height + len(codes[0]), by_index + len(codes[1]), nodes + len(cuts.heights)
    return by_height, by_index, nodes


def _check(cuts: Cuts, by_height: bytes, by_index: bytes, height: int) -> None:
    for back in (
        coding.from_height_form(by_height, len(cuts.heights), height),
        coding.from_index_form(by_index, len(cuts.heights), height),
    ):
        same = np.array_equal(back.heights, cuts.heights) and np.array_equal(back.values, cuts.values)
        if not same or not np.array_equal(back.first, cuts.first):
            raise ValueError("a code does not come back as the cuts that were written")


def _forms(by_height: int, by_index: int, nodes: int) -> Iterator[Row]:
    """All data where the vertices' nodes have so many bytes by height and by index."""
    for name, (short, long) in {"height, number and two bytes": NODE_BYTES, **OTHER_NODE_BYTES}.items():
        yield {"method": f"all data, SVC node: {name}", "height_bytes": round(by_height + short * nodes),
               "index_bytes": round(by_index + long * nodes),
               "height_over_index": _over(by_height, by_index, nodes, short, long)}  # fmt: skip


def _over(by_height: int, by_index: int, nodes: int, short: float, long: float) -> float:
    return (by_height + short * nodes) / (by_index + long * nodes)
