"""The order of steps: one mounting after the other, axes in serpentines, long exposures first."""

from collections.abc import Mapping, Sequence
from itertools import groupby, permutations, product

from rig.config import RigConfig
from rig.sessions.forecast import motion_time_s, reference_rad
from rig.sessions.step import Step

Pose = tuple[tuple[str, float], ...]
FACINGS = ("front", "back")  # where a camera in the hand looks, in the order in which it is asked to


def ordered(steps: Sequence[Step], config: RigConfig) -> tuple[Step, ...]:
    """Sorted by mounting, then by pose with the least travel from the reference position, then by lamp and exposure.

    Under a lamp the longest exposure comes first, so that a dead lamp shows before the dimmer pictures are taken;
    without one the steps keep the order in which they were laid out.
    """
    here, result = reference_rad(config), []
    rank = {lamp: place for place, lamp in enumerate(config.lamps.lamp)}
    for _, group in groupby(sorted(steps, key=_mounting), key=_mounting):
        by_pose: dict[Pose, list[Step]] = {}
        for step in group:
            by_pose.setdefault(step.pose, []).append(step)
        for pose in _shortest_tour(list(by_pose), here, config):
            result += sorted(by_pose[pose], key=lambda step: _by_light(step, rank))
            here = dict(pose)
    return tuple(result)


def _by_light(step: Step, rank: Mapping[str, int]) -> tuple[list[int], float]:
    return [rank[lamp] for lamp in step.lamps], -step.exposure_s if step.lamps else 0.0


def _mounting(step: Step) -> tuple[str, float, float, bool]:
    mount = step.mount or {}
    sample, pose, elevation_deg = (mount.get(key, 0) for key in ("sample", "pose", "laser_elevation_deg"))
    return str(sample), float(elevation_deg), float(pose), mount.get("facing", FACINGS[0]) != FACINGS[0]


def _shortest_tour(poses: list[Pose], start_rad: Mapping[str, float], config: RigConfig) -> list[Pose]:
    """The serpentine of least motion time, over all orders and directions of the axes that move at all."""
    moving = [name for name in dict(poses[0]) if len({dict(pose)[name] for pose in poses}) > 1]
    candidates = [
        _serpentine(poses, axes, signs)
        for axes in permutations(moving)
        for signs in product((1, -1), repeat=len(moving))
    ]
    return min(candidates, key=lambda tour: _travel_s(tour, start_rad, config))


def _serpentine(poses: list[Pose], axes: Sequence[str], signs: Sequence[int]) -> list[Pose]:
    """Sorted by the first axis, within equal angles by the next, whose direction turns round every time."""
    if not axes:
        return poses
    result: list[Pose] = []
    sign, turned = signs[0], list(signs[1:])
    for _, group in groupby(
        sorted(poses, key=lambda pose: sign * dict(pose)[axes[0]]), key=lambda pose: dict(pose)[axes[0]]
    ):
        result += _serpentine(list(group), axes[1:], turned)
        turned = [-direction for direction in turned]
    return result


def _travel_s(tour: Sequence[Pose], start_rad: Mapping[str, float], config: RigConfig) -> float:
    total_s, here = 0.0, start_rad
    for pose in map(dict, tour):
        total_s += motion_time_s(here, pose, config)
        here = pose
    return total_s
