"""The furnished room as the benchmark draws it."""

import numpy as np
import pytest

from render.errors import GlUnavailableError
from render.mesh import plain_mesh
from render.relit_reference import RelitReference
from render.relit_view import RelitView
from tests.benchmarks.relights.drawing import usual_camera
from tests.benchmarks.yardsticks.furniture import QUICK, furniture
from tests.benchmarks.yardsticks.relit_furniture import poses


def test_the_room_is_drawn_as_by_the_reference():
    """All vertices that it needs are asked for, a part of the room's, and slats let through what is behind them."""
    pieces, camera = furniture(QUICK), usual_camera((160, 120))
    meshes = [plain_mesh(each.body.vertices, each.body.normals, each.body.triangles) for each in pieces]
    try:
        view = RelitView(meshes)
    except GlUnavailableError as error:
        pytest.skip(str(error))
    reference, where = RelitReference(meshes), poses(pieces)
    visible = view.visible(camera, where)
    radiance = np.full((len(view.bodies.positions), 3), np.nan, np.float32)
    radiance[visible] = np.random.default_rng(1).uniform(0, 1, (len(visible), 3))
    drawn = view.draw(camera, where, radiance)
    assert len(visible) < 0.7 * len(radiance)
    assert np.isfinite(drawn.radiance).all()
    expected = reference.draw(camera, where, np.nan_to_num(radiance))
    assert (np.abs(drawn.radiance - expected.radiance).max(axis=2) > 0.02).mean() < 0.01
    assert len(np.setxor1d(visible, reference.visible(camera, where))) < 0.02 * len(visible)
    view.release()
