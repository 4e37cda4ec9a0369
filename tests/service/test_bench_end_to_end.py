"""The plans of the benchmark from sessions to pictures: what joining asks of them."""

import pytest

from tests.benchmarks.btf_mdfs.end_to_end import plans

SHARED = ("sample", "texels", "depth_mm", "turntable_deg", "cameras")


@pytest.mark.parametrize("quick", [True, False])
def test_btf_and_mdf_look_at_the_same_texels_from_the_same_views(quick):
    planned = plans(quick=quick)
    for name in SHARED:
        assert getattr(planned["btf"], name) == getattr(planned["mdf"], name)
    assert set(planned["btf"].cameras) <= set(planned["calibrate"].cameras)
