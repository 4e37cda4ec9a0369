"""`rig relight`: pictures and animations of a scene under the light of a place."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import pi, radians, sin
from pathlib import Path

from processing.errors import ImageError
from processing.progress import Progress
from render.picture import save_animation, save_image
from rig.errors import ConfigError
from service.files import check_folder, replaced
from service.pictures import STILL
from service.relit_scene import Place, RelitScene, open_scene
from service.relit_studio import Shot, Studio, precomputed
from service.viewing import ANIMATED

LEAST_PX, MOST_PX = 16, 4096


@dataclass(frozen=True)
class Wanted:
    """As a person gives it: WIDTH,HEIGHT in pixels, degrees, and BODY,X,Y in millimetres where a body is to go."""

    size: str = "720,480"
    light_azimuth_deg: float | None = None
    move: str = ""
    frames: int = 24


@dataclass(frozen=True)
class _Journey:
    body: str
    start: Place
    goal: Place

    def at(self, share: float) -> Place:
        """On the way."""
        x, y, z = ((1 - share) * a + share * b for a, b in zip(self.start.place_m, self.goal.place_m, strict=True))
        return replace(self.start, place_m=(x, y, z))


def draw_scene(path: Path, out: Path, kept: Path, wanted: Wanted, report: Progress) -> Iterator[str]:
    """Draw the scene of a file into `out`; tells what was done.

    With the ending of a moving picture the light goes round, or else the body to where it is to go and back. What is
    precomputed stays in the folder `kept`. Raises ConfigError, ImageError.
    """
    _check_ending(out)
    size = _size(wanted.size)
    scene = open_scene(path)
    yield from scene.doubts
    if wanted.light_azimuth_deg is not None:
        scene = replace(scene, light_azimuth_rad=radians(wanted.light_azimuth_deg))
    journey = _journey(wanted.move, scene) if wanted.move else None
    begun = time.monotonic()
    bodies = precomputed(scene, kept, report)
    yield (
        f"{path}: {len(bodies)} bodies of {sum(len(body.body.vertices) for body in bodies)} vertices, "
        f"{scene.precomputation.directions} directions; visibility in {kept} ({time.monotonic() - begun:.1f} s)"
    )
    with Studio(scene, bodies, size) as studio, replaced(out) as part:
        if out.suffix.lower() in ANIMATED:
            shares = [number / wanted.frames for number in range(wanted.frames)]
            shots = [_frame(studio, journey, share) for share in report.track(shares, "frames")]
            save_animation(part, [shot.codes for shot in shots])
        else:
            if journey is not None:
                studio.put(journey.body, journey.goal)
            shots = [studio.draw()]
            save_image(part, shots[0].codes)
        yield _about(shots)
        yield f"{out}: {size[0]} x {size[1]} pixels, drawn by {studio.renderer_name}"


def _frame(studio: Studio, journey: _Journey | None, share: float) -> Shot:
    if journey is None:
        studio.turn_light(studio.scene.light_azimuth_rad + 2 * pi * share)
    else:
        studio.put(journey.body, journey.at(sin(pi * share) ** 2))
    return studio.draw()


def _about(shots: list[Shot]) -> str:
    """What was found how in the last of the frames, and how long one took."""
    last, later = shots[-1], shots[1:] or shots
    mean_ms = 1e3 * sum(shot.lighting_s for shot in later) / len(later)
    return (
        f"{last.vertices} of {last.vertices_of_scene} vertices are in the picture: {last.recomputed.moving} lit anew, "
        f"{last.recomputed.cached} from known visibility, {last.recomputed.kept} as before; light took {mean_ms:.0f} ms"
        + (" a frame" if len(shots) > 1 else "")
    )


def _check_ending(out: Path) -> None:
    if out.suffix.lower() not in ANIMATED + STILL:
        raise ImageError(f"{out}: a picture is .png or .jpg, moving light .webp, .gif or .apng")
    check_folder(out)


def _size(text: str) -> tuple[int, int]:
    parts = text.split(",")
    if len(parts) != 2 or not all(part.strip().isdecimal() and LEAST_PX <= int(part) <= MOST_PX for part in parts):
        raise ConfigError(f"--size is WIDTH,HEIGHT, each {LEAST_PX} to {MOST_PX} pixels, not {text!r}")
    return int(parts[0]), int(parts[1])


def _journey(text: str, scene: RelitScene) -> _Journey:
    name, _, there = text.partition(",")
    bodies = {body.name: body for body in scene.bodies}
    if name not in bodies:
        raise ConfigError(f"--move: no body {name!r} in the scene, but {', '.join(bodies)}")
    try:
        x_mm, y_mm = (float(part) for part in there.split(","))
    except ValueError as error:
        raise ConfigError(f"--move is BODY,X,Y with millimetres on the floor, not {text!r}") from error
    start = bodies[name].place
    return _Journey(name, start, replace(start, place_m=(x_mm / 1e3, y_mm / 1e3, start.place_m[2])))
