"""The exposure of laser sweeps, chosen from a test sweep: on white the stripe peaks a little under saturation.

More would clip it, less would bury it in noise, and an exposure no longer than that keeps light that bounced twice in
the dark. White is the brightest matt thing in view and fills more than a hundredth of it; glints fill less.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from math import ceil

import numpy as np

from rig.errors import DeviceError, FrameCheckError
from rig.sessions.checks import Shot
from rig.sessions.plan import EXPOSURE_STEP_S, in_steps_s
from rig.sessions.step import Step

TARGET = 0.7  # of full scale; the rest is for a laser and a motor that vary from sweep to sweep
FULL = 0.95  # from here on a level counts as saturated: sensors bend before they clip
LONGEST = 0.5  # of the time between two frames: longer blurs the stripe, and the read-out takes its time too
FIRST_TRY = 0.25  # of the longest: what it finds too dim to be measured gets the longest anyway
SHORTER = 0.125  # of an exposure that was saturated
SPARSER = 4  # times fewer frames than a sweep: enough that the stripe stands on every tenth point of the white
_BRIGHTEST = 0.99
_STAYS = 0.5  # of the brightest level: where this much is there without the stripe, it was not the stripe's


def longest_s(interval_s: float) -> float:
    """The longest exposure that sweeps with this time between two frames are given."""
    return in_steps_s(LONGEST * interval_s)


def with_tests(steps: Sequence[Step]) -> tuple[Step, ...]:
    """A test sweep before the first sweep of every mounting, in the same pose."""
    result: list[Step] = []
    for before, step in pairwise([None, *steps]):
        assert step is not None
        if before is None or before.mount != step.mount:
            result.append(_test(step))
        result.append(step)
    return tuple(result)


def stripe_level(shot: Shot) -> float:
    """How much of full scale the stripe reaches on the brightest hundredth of one colour's pixels.

    Raises FrameCheckError where no stripe passes, or one that is no brighter than the light that stays.
    """
    assert shot.burst is not None
    black_dn, white_dn = float(shot.attributes["black_dn"]), float(shot.attributes["white_dn"])
    brightest, darkest = shot.burst.max(axis=0), shot.burst.min(axis=0)
    levels = [
        [float(np.quantile(level[row::2, column::2], _BRIGHTEST)) - black_dn for level in (brightest, darkest)]
        for row in (0, 1)
        for column in (0, 1)
    ]
    peak_dn, stays_dn = max(levels)
    if peak_dn <= max(stays_dn / _STAYS, 0.0):
        raise FrameCheckError(
            f"{shot.camera}: no stripe passes, or the room is brighter than it: of at most {peak_dn:.0f} dn over black "
            f"{stays_dn:.0f} dn are there all the time. Is the laser on, is another light?"
        )
    return peak_dn / (white_dn - black_dn)


def shorter_test(test: Step) -> Step:
    """The test sweep after one that was saturated. Raises DeviceError where no exposure is shorter."""
    if test.exposure_s <= EXPOSURE_STEP_S:
        raise DeviceError(
            f"the laser's stripe saturates {', '.join(test.cameras)} even within {test.exposure_s:g} s: "
            "stop the lens down, lower the ISO, or dim the laser."
        )
    return replace(test, exposure_s=in_steps_s(SHORTER * test.exposure_s))


def chosen_s(test: Step, level: float) -> float:
    """The exposure that brings the level which the test sweep reached to TARGET, or the longest."""
    return min(in_steps_s(test.exposure_s * TARGET / level), longest_s(test.interval_s / SPARSER))


def _test(sweep: Step) -> Step:
    interval_s = SPARSER * sweep.interval_s
    return replace(
        sweep, id=f"{sweep.id}_test", exposure_s=in_steps_s(FIRST_TRY * longest_s(sweep.interval_s)),
        frames=ceil(sweep.frames / SPARSER), interval_s=interval_s, test=True,
    )  # fmt: skip
