"""Lamp models from what the mirror ball and the white plate tell, together."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from processing.lamps.mirror import MirrorFit, Sighting
from processing.lamps.model import (
    DIRECTION_SIGMA_RAD,
    DISTANCE_SIGMA,
    LampModel,
    LampPlaces,
    LampStatus,
    NominalLamp,
    nominal_places,
)
from processing.lamps.white import PlateView, WhiteFit, fit_plate

_LEARNT = 0.5  # of what was believed beforehand: a deviation above this share of it is no measurement


def measure_lamps(
    nominal: Mapping[str, NominalLamp],
    sightings: Sequence[Sighting],
    mirror: MirrorFit | None,
    views: Sequence[PlateView],
    reflectance: float,
) -> tuple[dict[str, LampModel], WhiteFit | None]:
    """A model of every nominal lamp, and the fit of the white plate where there are views of it.

    What the mirror tells of all places, with its covariance, goes into the fit of the plate; without a mirror the
    nominal places do. A lamp that nothing showed keeps its nominal place and says so. `reflectance` is the plate's.
    Raises CalibrationError where views are given and none of them is lit.
    """
    places = nominal_places(nominal) if mirror is None else mirror.places
    white = fit_plate(views, places, reflectance) if views else None
    seen = _seen(sightings, mirror) | {view.lamp for view in views if view.seen.any()}
    found = places if white is None else white.places
    models = {name: _model(name, nominal[name], found, white) for name in nominal}
    return {name: _rated(model, nominal[name], seen=name in seen) for name, model in models.items()}, white


def _seen(sightings: Sequence[Sighting], mirror: MirrorFit | None) -> set[str]:
    if mirror is None:
        return set()
    return {sighting.lamp for sighting, weight in zip(sightings, mirror.weight, strict=True) if weight > 0}


def _model(name: str, nominal: NominalLamp, places: LampPlaces, white: WhiteFit | None) -> LampModel:
    row = places.names.index(name)
    model = LampModel(name, nominal.mount, places.positions_m[row], places.covariance(name))
    if white is None or not np.isfinite(white.log_intensity[row]).any():
        return model
    intensity = np.exp(white.log_intensity[row])
    return replace(
        model,
        intensity_e_s=intensity,
        intensity_deviation=intensity * np.sqrt(white.log_variance[row]),
        falloff=white.held,
        falloff_deviation=white.falloff_deviation,
    )


def _rated(model: LampModel, nominal: NominalLamp, *, seen: bool) -> LampModel:
    """The model with its status; the nominal one where nothing was learnt of the direction."""
    if not seen or model.direction_deviation_rad > _LEARNT * np.sqrt(2) * DIRECTION_SIGMA_RAD:
        believed = nominal_places({model.name: nominal})
        return LampModel(
            model.name, model.mount, believed.positions_m[0], believed.covariance_m2, LampStatus.NOT_MEASURED
        )
    assumed = model.distance_deviation_m > _LEARNT * DISTANCE_SIGMA * model.distance_m
    return replace(model, status=LampStatus.DISTANCE_ASSUMED if assumed else LampStatus.MEASURED)
