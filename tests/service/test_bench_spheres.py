"""The benchmark's rows of spheres say what their names do."""

from tests.benchmarks.srfs.spheres import DOME, circle_errors, map_errors, spread
from tests.benchmarks.yardsticks.sphere_shots import SphereShots


def test_a_sphere_is_found_and_a_distant_camera_is_an_assumption_that_costs():
    shots = SphereShots(4, "sphere-wax", "cam7", DOME[::3])
    found = circle_errors(shots)
    assert found["centre_px"] < 0.2
    assert abs(found["radius_px"]) < 0.3  # four lights alone
    assert [row["worst"] for row in spread([found])] == [found["centre_px"], abs(found["radius_px"])]
    near, distant = (map_errors(shots, orthographic=far) for far in (False, True))
    assert near["rms"] < 0.03
    assert distant["rms"] > 1.5 * near["rms"]
    assert near["brightness"] < 1.04  # the card lies where the lens gives less light, by a percent or two
