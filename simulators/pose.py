"""The state of the world that light depends on."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Pose:
    """Where everything stands and what shines, at one exposure.

    `lamps` holds (name, level in (0, 1]) of the lit lamps, sorted by name. `laser_sweep` holds the depression angle of
    the laser's fan plane below the horizontal at the start and the end of the exposure, None when it does not shine.
    `board_pose` counts for the ChArUco board only: 0 lies flat on the reference plane, others are tilted. The white
    card beside a sphere faces a camera at azimuth 0 and `card_elevation_rad`. The phone is held at `place`, `facing`
    front or back.
    """

    sample: str
    board_pose: int
    turntable_rad: float
    light_arc_rad: float
    arm_rad: float
    lamps: tuple[tuple[str, float], ...]
    laser_elevation_rad: float
    laser_on: bool
    laser_sweep: tuple[float, float] | None
    card_elevation_rad: float = 0.0
    place: str = "room"
    facing: str = "front"
