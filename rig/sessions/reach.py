"""Which angles an axis may take, from rig.toml alone: nothing is asked of a device, nothing moves.

An axis runs straight from one angle to the next. Its path lies within the soft limits where both ends do. In a
forbidden zone nothing may stand, but an axis may pass through it on its way. A collision zone may not even be passed:
what lies behind one, as seen from the reference position, cannot be reached, and between any two angles that can be
reached the way is free.
"""

from collections.abc import Iterator

from rig.config import AxisConfig
from rig.errors import InterlockError, LimitError

_DUST_DEG = 1e-6  # sums of angles in binary fractions; far below any axis' step
_FULL_TURN_DEG = 360.0


def reachable_deg(name: str, axis: AxisConfig, wanted_deg: float) -> float:
    """The wanted angle, or where the axis cannot take it the equivalent one (whole turns away) nearest to 0.

    Raises LimitError where no equivalent lies within the soft limits, InterlockError where those that do are forbidden.
    """
    wanted_deg = round(wanted_deg, 6) + 0.0
    within = [angle for angle in _equivalents(axis, wanted_deg) if axis.min_deg <= angle <= axis.max_deg]
    if not within:
        raise LimitError(
            f"{name}: {wanted_deg:g} deg is outside {axis.min_deg:g} to {axis.max_deg:g} deg, also by whole turns; "
            f"nothing was moved. Limits are set in rig.toml, [axes.{name}]."
        )
    free = [angle for angle in within if _obstacle(axis, angle) is None]
    if not free:
        raise InterlockError(
            f"{name}: {wanted_deg:g} deg {_obstacle(axis, within[0])}; nothing was moved. "
            f"Zones are set in rig.toml, [axes.{name}]."
        )
    return free[0]


def standby_deg(name: str, axis: AxisConfig) -> float:
    """Where an axis stands that a plan does not use: at 0, or at the allowed whole degree nearest to it.

    Raises LimitError or InterlockError where there is no such degree.
    """
    for distance in range(int(_FULL_TURN_DEG)):
        for angle in (float(distance), float(-distance)):
            if axis.min_deg <= angle <= axis.max_deg and _obstacle(axis, angle) is None:
                return angle + 0.0
    return reachable_deg(name, axis, 0.0)


def _equivalents(axis: AxisConfig, wanted_deg: float) -> Iterator[float]:
    """The wanted angle, then the others within the limits by their distance from 0."""
    yield wanted_deg
    first = int((axis.min_deg - wanted_deg) // _FULL_TURN_DEG)
    last = int((axis.max_deg - wanted_deg) // _FULL_TURN_DEG)
    others = [wanted_deg + turn * _FULL_TURN_DEG for turn in range(first, last + 1) if turn != 0]
    yield from sorted((round(angle, 6) + 0.0 for angle in others), key=lambda angle: (abs(angle), angle))


def _obstacle(axis: AxisConfig, angle_deg: float) -> str | None:
    """Why the axis may not go to this angle; None where it may."""
    for zone in axis.forbidden_deg:
        if _meets(zone, angle_deg, angle_deg):
            return f"is forbidden ({zone[0]:g} to {zone[1]:g} deg), because there it would block the view"
    for zone in axis.collision_deg:
        if _meets(zone, min(angle_deg, 0.0), max(angle_deg, 0.0)):
            return f"cannot be reached: the way leads into a collision at {zone[0]:g} to {zone[1]:g} deg"
    return None


def _meets(zone: tuple[float, float], low_deg: float, high_deg: float) -> bool:
    """Both ends count as inside: nobody wants to stand on the edge of a collision."""
    return high_deg >= zone[0] - _DUST_DEG and low_deg <= zone[1] + _DUST_DEG
