"""A relighting session: one thread holds a scene and its graphics context, makes what changes clients ask for, and
shows the result."""

import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from dataclasses import dataclass
from math import degrees
from typing import Any

import cv2
import numpy as np

from processing.lighting.surroundings import RelitBody
from service.jobs import Job, Jobs
from service.problems import DEFECT, problem_of
from service.relit_messages import Change
from service.relit_scene import RelitScene
from service.relit_studio import Shot, Studio

IDLE_S = 900.0
SETTLED_S = 0.2  # after a rough picture: when nothing has changed since, a full one
_WATCH_S = 0.2  # between looks at how far the precomputation is
_JPEG_QUALITY = 88

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Told:
    """A message, with the picture that it is about, if it is about one."""

    message: dict[str, Any]
    picture: bytes | None = None


Listener = Callable[[Told], None]


class RelightingSession:
    """A scene that clients look at and change; it ends when it is told to, or when nobody says anything for `idle_s`.

    `prepare` computes the bodies' visibility, in a job. Listeners are called in the session's thread.
    """

    def __init__(
        self,
        title: str,
        scene: RelitScene,
        prepare: Callable[[Job], list[RelitBody]],
        jobs: Jobs,
        idle_s: float = IDLE_S,
    ) -> None:
        self.title, self.scene, self.state = title, scene, "precomputing"
        self._jobs, self._idle_s, self._heard_s = jobs, idle_s, time.monotonic()
        self._changes: dict[str, Change] = {}
        self._listeners: set[Listener] = set()
        self._newcomers = False
        self._end: str | None = None
        self._last_word: Told | None = None
        self._problem: dict[str, str] | None = None
        self._standing: dict[str, Any] = {}
        self._news = threading.Condition()
        self._bodies: Future[list[RelitBody]] = Future()
        self.job = jobs.submit(f"precompute {title}", lambda job: self._prepare(prepare, job))
        self._thread = threading.Thread(target=self._run, name=f"relighting of {title}", daemon=True)
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether it still goes on."""
        return self._thread.is_alive()

    def describe(self) -> dict[str, Any]:
        """What it is, how far it is, and what names can be said to it."""
        return {
            "title": self.title, "state": self.state, "job": self._jobs.read(self.job), "problem": self._problem,
            "bodies": [body.name for body in self.scene.bodies], "materials": list(self.scene.materials),
            "environments": list(self.scene.environments), "doubts": self.scene.doubts, "standing": self._standing,
        }  # fmt: skip

    def tell(self, change: Change) -> None:
        """Make a change soon, merged with an earlier one of the same subject that has not been made yet.

        Raises NotFoundError where it names what the scene does not have.
        """
        change.check(self.scene)
        with self._news:
            earlier = self._changes.get(change.subject)
            self._changes[change.subject] = change if earlier is None else change.after(earlier)
            self._heard_s = time.monotonic()
            self._news.notify_all()

    def listen(self, listener: Listener) -> None:
        """Hear of everything from now on, beginning with the scene as it stands; of one that has ended, why."""
        with self._news:
            self._listeners.add(listener)
            if self._last_word is not None:
                listener(self._last_word)
            self._newcomers, self._heard_s = True, time.monotonic()
            self._news.notify_all()

    def leave(self, listener: Listener) -> None:
        """Hear no more."""
        with self._news:
            self._listeners.discard(listener)

    def end(self, reason: str) -> None:
        """End it and wait until its thread and its graphics context are gone."""
        with self._news:
            self._end = self._end or reason
            self._news.notify_all()
        self._thread.join()

    def _prepare(self, prepare: Callable[[Job], list[RelitBody]], job: Job) -> None:
        try:
            self._bodies.set_result(prepare(job))
        except BaseException as error:
            self._bodies.set_exception(error)
            raise

    def _run(self) -> None:
        try:
            bodies = self._precomputed()
            with Studio(self.scene, bodies) as studio:
                self._serve(studio)
        except CancelledError:
            self._end = self._end or "the precomputation was cancelled"
        except Exception as error:
            if problem_of(error) is None:
                log.exception("relighting of %s", self.title)
            self._end, self._problem = "it failed", problem_told(error)
            self._say({"kind": "problem", **self._problem})
        self.state = "ended" if self._problem is None else "failed"
        self._jobs.cancel(self.job)
        with self._news:
            self._last_word = Told({"kind": "end", "reason": self._end})
            for listener in self._listeners:
                listener(self._last_word)

    def _precomputed(self) -> list[RelitBody]:
        """Wait for the job and tell how far it is. Raises its error, and CancelledError where the end comes first."""
        begun_s, stage = time.monotonic(), ""
        while not self._bodies.done():
            job = self._jobs.read(self.job)
            if job["state"] == "cancelled":
                raise CancelledError
            if job["stage"] != stage:
                begun_s, stage = time.monotonic(), job["stage"]
            left_s = (time.monotonic() - begun_s) * (job["total"] / job["done"] - 1) if job["done"] else None
            self._say({"kind": "progress", "stage": stage, "done": job["done"], "total": job["total"], "eta_s": left_s})
            with self._news:
                if self._news.wait_for(lambda: self._end is not None, _WATCH_S):
                    raise CancelledError
        return self._bodies.result()

    def _serve(self, studio: Studio) -> None:
        self.state, self._standing, self._heard_s = "ready", standing(studio), time.monotonic()
        self._say({"kind": "ready", **self.describe()})
        rough = False
        while (changes := self._next(rough)) is not None:
            for change in changes:
                self._make(change, studio)
            rough = any(change.rough for change in changes)
            shot = studio.draw(rough=rough)
            self._standing = standing(studio)
            self._say(
                {"kind": "frame", "rough": rough, **_about(shot), "standing": self._standing}, encoded(shot, rough)
            )

    def _next(self, rough: bool) -> list[Change] | None:
        """Wait for changes, for somebody new, or until a rough picture has settled; None at the end."""
        with self._news:
            patience_s = SETTLED_S if rough else max(self._heard_s + self._idle_s - time.monotonic(), 0.0)
            heard = self._news.wait_for(lambda: self._end or self._changes or self._newcomers, patience_s)
            if not (heard or rough):
                self._end = f"nobody said anything for {self._idle_s:.0f} s"
            if self._end is not None:
                return None
            changes = list(self._changes.values())
            self._changes.clear()
            self._newcomers = False
            return changes

    def _make(self, change: Change, studio: Studio) -> None:
        """One that cannot be made leaves the scene as it was."""
        try:
            change.apply(studio)
        except Exception as error:
            if problem_of(error) is None:
                raise
            self._say({"kind": "problem", **problem_told(error)})

    def _say(self, message: dict[str, Any], picture: bytes | None = None) -> None:
        with self._news:
            listeners = list(self._listeners)
        for listener in listeners:
            listener(Told(message, picture))


def problem_told(error: Exception) -> dict[str, str]:
    """Code and detail of an error, as of `service.problems`."""
    return {"code": (problem_of(error) or DEFECT).code, "detail": str(error)}


def standing(studio: Studio) -> dict[str, Any]:
    """The scene as it is, as people write it."""
    orbit = studio.orbit
    return {
        "eye": {
            "azimuth_deg": degrees(orbit.azimuth_rad), "elevation_deg": degrees(orbit.elevation_rad),
            "distance_mm": 1e3 * orbit.distance_m, "target_mm": [1e3 * value for value in orbit.target_m],
            "field_of_view_deg": degrees(orbit.field_of_view_rad),
        },
        "light_azimuth_deg": degrees(studio.light_azimuth_rad), "environment": studio.environment,
        "bodies": {
            name: {
                "place_mm": [1e3 * value for value in place.place_m],
                "turn_deg": [degrees(value) for value in place.turn_rad], "material": studio.materials[name],
            }
            for name, place in studio.places.items()
        },
        "drawn_by": studio.renderer_name,
    }  # fmt: skip


def encoded(shot: Shot, rough: bool) -> bytes:
    """A rough picture as JPEG, a full one without loss as PNG."""
    blue_first = np.ascontiguousarray(shot.codes[..., ::-1])
    if rough:
        return bytes(cv2.imencode(".jpg", blue_first, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1])
    return bytes(cv2.imencode(".png", blue_first, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1])


def _about(shot: Shot) -> dict[str, Any]:
    height, width = shot.codes.shape[:2]
    return {
        "width_px": width, "height_px": height, **shot.recomputed._asdict(),
        "visible_share": shot.vertices / shot.vertices_of_scene,
        "lighting_ms": 1e3 * shot.lighting_s, "drawing_ms": 1e3 * shot.drawing_s,
    }  # fmt: skip
