"""Results kept by what they are of: found again, told apart, made again where they are damaged."""

import numpy as np
import pytest

from processing.lighting import precomputation
from processing.lighting.directions import sample_directions
from processing.lighting.field import trace_field
from processing.lighting.outline import FlatOutline
from processing.lighting.precomputation import cached_field, cached_self_visibility, precompute
from processing.lighting.self_visibility import self_visibility
from processing.lighting.shells import ShellPlan
from processing.lighting.triangle_body import triangle_body
from tests.processing.lighting.bodies import box, square

SAMPLED, PLAN = sample_directions(7), ShellPlan(3)


class Told:
    """Progress that remembers."""

    def __init__(self):
        self.seen = []

    def track(self, items, description):
        for item in items:
            self.seen.append(description)
            yield item


@pytest.fixture
def body():
    return triangle_body(*box())


def test_what_comes_from_disk_is_what_was_traced(body, tmp_path):
    made = precompute(body, SAMPLED, tmp_path, tolerance=0.02, shells=PLAN)
    traced, _ = trace_field(body, SAMPLED, PLAN.around(body.centre, body.radius))
    cuts, _ = self_visibility(body, SAMPLED, 0.02)
    assert np.array_equal(made.field.first, traced.first)
    assert np.array_equal(made.field.toggles, traced.toggles)
    assert np.array_equal(made.self_visibility.heights, cuts.heights)
    assert np.allclose(made.self_visibility.values, cuts.values, atol=1e-5)


def test_the_second_time_nothing_is_traced(body, tmp_path):
    once, again = Told(), Told()
    one = cached_field(body, SAMPLED, tmp_path, once, shells=PLAN)
    two = cached_field(body, SAMPLED, tmp_path, again, shells=PLAN)
    assert once.seen == ["visibility field"] * 3
    assert again.seen == []
    assert one[1] == two[1]
    assert one[1].rays > 0
    assert np.array_equal(one[0].toggles, two[0].toggles)


def test_other_inputs_are_other_files(body, tmp_path, monkeypatch):
    def files():
        cached_self_visibility(given, SAMPLED, tmp_path, tolerance=tolerance)
        cached_field(given, SAMPLED, tmp_path, shells=plan)
        return len(list(tmp_path.iterdir()))

    given, tolerance, plan = body, 0.02, PLAN
    assert files() == 2
    assert files() == 2
    tolerance = 0.03
    assert files() == 3
    plan = ShellPlan(3, "uniform")
    assert files() == 4
    given = triangle_body(*box((-0.5, -0.5, -0.5), (0.5, 0.5, 0.501)))
    assert files() == 6
    monkeypatch.setattr(precomputation, "VERSION", 0)
    assert files() == 8


def test_normals_matter_to_the_vertices_alone(tmp_path):
    vertices, triangles = box()
    for normals in (None, np.tile([0.0, 0.6, 0.8], (8, 1))):
        precompute(triangle_body(vertices, triangles, normals), SAMPLED, tmp_path, shells=PLAN)
    assert sorted(path.name[:3] for path in tmp_path.iterdir()) == ["svc", "svc", "vcf"]


def test_what_cannot_be_used_of_a_mesh_is_left_out(tmp_path):
    """Open, without normals, with triangles without area and a vertex in none: that one sees nothing."""
    vertices, triangles = box()
    broken = np.concatenate([triangles[2:], [[0, 0, 1], [2, 2, 2]]])
    body = triangle_body(np.concatenate([vertices, [[9.0, 9, 9]]]), broken)
    made = precompute(body, SAMPLED, tmp_path, shells=PLAN)
    assert made.self_visibility.leaves(0).max() > 0.5
    assert made.self_visibility.leaves(8).max() == 0
    assert len(body.triangles) == 10
    assert made.field.mean_cut > 1


def test_a_flat_body_has_an_outline_and_no_field(tmp_path):
    made = precompute(triangle_body(*square()), SAMPLED, tmp_path, shells=PLAN)
    assert isinstance(made.field, FlatOutline)
    assert [path.name[:3] for path in tmp_path.iterdir()] == ["svc"]


@pytest.mark.parametrize("damage", [lambda b: b[: len(b) // 2], lambda b: b"", lambda b: b[:99] + b"\0" * 64 + b[163:]])
def test_damaged_files_are_made_again(body, tmp_path, damage):
    precompute(body, SAMPLED, tmp_path, shells=PLAN)
    whole = {path.name: path.stat().st_size for path in tmp_path.iterdir()}
    for path in tmp_path.iterdir():
        path.write_bytes(damage(path.read_bytes()))
    made, told = precompute(body, SAMPLED, tmp_path, shells=PLAN), Told()
    assert len(made.field.first) == len(made.field.shells) + 1
    assert {path.name for path in tmp_path.iterdir()} == set(whole)
    precompute(body, SAMPLED, tmp_path, told, shells=PLAN)
    assert told.seen == []


def test_what_breaks_off_leaves_nothing_behind(body, tmp_path):
    class Cancelled(Told):
        def track(self, items, description):
            yield next(iter(items))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cached_field(body, SAMPLED, tmp_path, Cancelled(), shells=PLAN)
    assert list(tmp_path.iterdir()) == []
