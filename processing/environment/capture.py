"""Two bracketed fish-eye photographs, front and back, to the light of a place."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from processing import geometry
from processing.cameras.lens import Fisheye
from processing.environment.brackets import Bracket, ProbePhotograph, merge_brackets
from processing.environment.cloning import clone_clean
from processing.environment.fisheye_pair import FisheyePair, FisheyeView, cubemap_of_pair
from processing.environment.image_circle import ImageCircle, equidistant, find_circle
from processing.environment.reflections import FrameReflections, find_reflections
from processing.environment.registration import Registration, RegistrationStatus, View, register
from processing.errors import ImageError
from processing.products.arrays import Float64
from processing.products.light_environment import Environment
from processing.products.provenance import Provenance
from processing.radiometry.response import Response

_RIM = 0.985  # of the field: what lies farther out is blurred by the rim
FRONT = geometry.look_at(np.zeros(3), (1.0, 0.0, 0.0))[:3, :3]


@dataclass(frozen=True, eq=False)
class CaptureOptions:
    """How two photographs become an environment.

    `field_rad`: the lens's field of view, which the image circle shows whole. `size`: texels along a face. `lens`:
    calibrated; else equidistant, by the circle. `mask` (h, w): the frame's reflections as a person marked them; else
    they are looked for, unless `detect` is off. `front_from_back` (3, 3): the turn between the photographs as it is
    known; else it is found at the seam. `world_from_front` (3, 3): how the front camera stood, looking along +X with
    +Z up unless told.
    """

    field_rad: float
    size: int = 128
    lens: Fisheye | None = None
    mask: NDArray[np.bool_] | None = None
    detect: bool = True
    front_from_back: Float64 | None = None
    world_from_front: Float64 | None = None


@dataclass(frozen=True, eq=False)
class CapturedEnvironment:
    """An `environment`, and what was found on the way.

    `clipped` and `uncovered` are shares of the sphere: of which at least so much light is known as the shortest
    exposure measures, and of which no photograph tells. `registration` says the turn that was used.
    """

    environment: Environment
    circles: tuple[ImageCircle, ImageCircle]
    reflections: FrameReflections
    registration: Registration
    clipped: float
    uncovered: float
    response: Response | None


def capture_environment(front: Bracket, back: Bracket, options: CaptureOptions) -> CapturedEnvironment:
    """The light of a place from bracketed front and back photographs, in the camera's relative units.

    Raises ImageError that says why: brackets that cannot be merged, no image circle, front and back that do not fit.
    """
    photographs = merge_brackets(front, back)
    names = tuple(path.name for bracket in (front, back) for path in bracket.files)
    return environment_of(photographs, options, names)


def environment_of(
    photographs: tuple[ProbePhotograph, ProbePhotograph], options: CaptureOptions, names: tuple[str, ...] = ()
) -> CapturedEnvironment:
    """As `capture_environment`, of photographs that are merged already; `names` go into the provenance."""
    circles = _circles(photographs, options)
    lens = options.lens or equidistant(_joint(circles), options.field_rad)
    frame = _reflections(photographs, circles, options)
    views = [
        View(photograph.luminance, ~mask & ~photograph.clipped)
        for photograph, mask in zip(photographs, (frame.front, frame.back), strict=True)
    ]
    registration = _registered(views, lens, options)
    pair = _pair(photographs, frame, registration, options)
    parameters = {
        "field_deg": float(np.degrees(options.field_rad)),
        "reflections": frame.count,
        "registration": registration.status.name,
        "exposure_ratio": registration.exposure_ratio,
        "uncovered": pair.uncovered,
    }
    environment = Environment(cubemap_of_pair(pair, options.size), Provenance(names, parameters=parameters))
    clipped = np.concatenate([photograph.clipped.ravel() for photograph in photographs])
    share = float(pair.solid_angles[clipped].sum() / (4 * np.pi))
    response = photographs[0].response
    return CapturedEnvironment(environment, circles, frame, registration, share, pair.uncovered, response)


def _circles(
    photographs: tuple[ProbePhotograph, ProbePhotograph], options: CaptureOptions
) -> tuple[ImageCircle, ImageCircle]:
    found = find_circle(photographs[0].luminance), find_circle(photographs[1].luminance)
    if options.lens is None:
        for circle in found:
            circle.check()
    return found


def _joint(circles: tuple[ImageCircle, ImageCircle]) -> ImageCircle:
    """One lens took both: the mean of their circles, each by its own certainty."""
    weights = np.array([1.0 / max(circle.sigma_px, 1e-3) ** 2 for circle in circles])
    weights /= weights.sum()
    centre = weights @ np.stack([circle.centre_px for circle in circles])
    radius = float(weights @ [circle.radius_px for circle in circles])
    return replace(circles[0], centre_px=np.asarray(centre, np.float64), radius_px=radius)


def _reflections(
    photographs: tuple[ProbePhotograph, ProbePhotograph],
    circles: tuple[ImageCircle, ImageCircle],
    options: CaptureOptions,
) -> FrameReflections:
    shape = photographs[0].picture.shape[:2]
    if options.mask is not None:
        if options.mask.shape != shape:
            raise ImageError(f"a mask of {options.mask.shape} pixels for photographs of {shape}.")
        return FrameReflections(options.mask, options.mask, 0)
    if not options.detect:
        nothing = np.zeros(shape, np.bool_)
        return FrameReflections(nothing, nothing, 0)
    return find_reflections(photographs[0].picture, photographs[1].picture, circles)


def _registered(views: list[View], lens: Fisheye, options: CaptureOptions) -> Registration:
    if options.front_from_back is not None:
        given = np.asarray(options.front_from_back, np.float64)
        return Registration(given, 1.0, lens, 0.0, 1.0, 0.0, RegistrationStatus.ALIGNED)
    found = register(views[0], views[1], lens, options.field_rad)
    found.check()
    # A calibrated lens is believed more than what the seam says of it.
    return found if options.lens is None else replace(found, lens=lens)


def _pair(
    photographs: tuple[ProbePhotograph, ProbePhotograph],
    frame: FrameReflections,
    registration: Registration,
    options: CaptureOptions,
) -> FisheyePair:
    world_from_front = FRONT if options.world_from_front is None else options.world_from_front
    frames = world_from_front, world_from_front @ registration.front_from_back
    ratio = 1.0 if all(photograph.absolute for photograph in photographs) else registration.exposure_ratio
    views = []
    for photograph, mask, rotation, factor in zip(
        photographs, (frame.front, frame.back), frames, (1.0, ratio), strict=True
    ):
        reach = 0.5 * options.field_rad * _RIM
        bare = FisheyeView(photograph.picture, registration.lens, reach, rotation, ~mask)
        seen = np.nan_to_num(bare.polar_rad, nan=np.pi) <= 0.5 * options.field_rad
        hidden = (mask | ~np.isfinite(photograph.picture).all(axis=-1)) & seen
        picture = clone_clean(photograph.picture, hidden, seen, registration.lens.matrix[:2, 2])
        picture = factor * np.nan_to_num(picture)
        views.append(FisheyeView(picture, registration.lens, reach, rotation, ~hidden))
    return FisheyePair(*views)
