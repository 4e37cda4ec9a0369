"""The photographs of an `srf` session, merged, with what lights the body and what the plan says of the card."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.materials.photographs import BodyPhotographs
from processing.materials.white_card import WhiteCard
from rig.sessions import Session, SrfPlan
from service.pipeline.calibrations import Calibrations
from service.pipeline.inputs import Progress
from service.pipeline.stacks import MergedStack, lamp_distance_m, light_direction, merge, only_lamp, stacks

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LitBody:
    """Merged stacks, one per light, and the lights' places (light, 3) in the rig frame."""

    merged: list[MergedStack]
    places_m: Array
    lamps: tuple[str, ...]

    def photographs(self, centre_m: Array, rig_from_view: Array, radius_m: float) -> BodyPhotographs:
        """As seen about a body's centre (3,) in the axes `rig_from_view` (3, 3)."""
        way_m = (self.places_m - centre_m) @ rig_from_view
        distances_m = np.linalg.norm(way_m, axis=1)
        names = sorted(set(self.lamps))
        return BodyPhotographs(
            np.stack([one.radiance.value for one in self.merged]),
            np.stack([one.radiance.variance for one in self.merged]),
            self.merged[0].cfa,
            way_m / distances_m[:, None],
            distances_m,
            radius_m,
            np.array([names.index(lamp) for lamp in self.lamps]),
        )


def read_body(session: Session, calibrations: Calibrations, progress: Progress) -> LitBody:
    """Merge the exposures under every light; lamps stand where they were measured, else where rig.toml has them."""
    gathered = stacks(session.frames())
    merged = [merge(stack, calibrations) for stack in progress.track(gathered, "merging exposures")]
    directions = np.stack([light_direction(session.config, stack.step, calibrations) for stack in gathered])
    distances_m = np.array([lamp_distance_m(session.config, stack.step, calibrations) for stack in gathered])
    lamps = tuple(only_lamp(stack.step) for stack in gathered)
    return LitBody(merged, directions * distances_m[:, None], lamps)


def white_card(plan: SrfPlan) -> WhiteCard:
    """The plan's card in metres."""
    card = plan.card
    return WhiteCard(card.y_mm / 1e3, card.z_mm / 1e3, card.width_mm / 1e3, card.height_mm / 1e3, card.reflectance)
