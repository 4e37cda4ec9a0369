"""The relighting sessions of one service, and what its folders have for them: scenes and environments."""

import threading
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any

from processing.lighting.surroundings import RelitBody
from rig.errors import BusyError
from service.jobs import Job, Jobs
from service.problems import NotFoundError
from service.relit_scene import RelitScene
from service.relit_session import IDLE_S, RelightingSession
from service.relit_studio import precomputed

MOST = 3  # at a time: each holds a graphics context and the visibility of all its bodies


class Relightings:
    """At most three sessions; `kept` is the folder for what is precomputed."""

    def __init__(self, kept: Path, jobs: Jobs, idle_s: float = IDLE_S) -> None:
        self._kept, self._jobs, self._idle_s = kept, jobs, idle_s
        self._sessions: dict[int, RelightingSession] = {}
        self._numbers = count(1)
        self._lock = threading.Lock()
        self._closed = False

    def open(self, title: str, make: Callable[[], RelitScene]) -> int:
        """Open a session and return its number; those that have ended are forgotten. Raises BusyError for too many."""
        self._check_room()
        scene = make()

        def prepare(job: Job) -> list[RelitBody]:
            return precomputed(scene, self._kept, job)

        with self._lock:
            self._check_room()
            self._sessions = {number: each for number, each in self._sessions.items() if each.alive}
            number = next(self._numbers)
            self._sessions[number] = RelightingSession(title, scene, prepare, self._jobs, self._idle_s)
        return number

    def list(self) -> list[dict[str, Any]]:
        """Every session that is remembered."""
        return [self.read(number) for number in list(self._sessions)]

    def read(self, number: int) -> dict[str, Any]:
        """What a session tells of itself. Raises NotFoundError where there is none."""
        return {"id": number, **self.session(number).describe()}

    def session(self, number: int) -> RelightingSession:
        """One session. Raises NotFoundError where there is none."""
        if number not in self._sessions:
            raise NotFoundError(
                f"no relighting {number}; it ended, or the service was started again: open the scene anew."
            )
        return self._sessions[number]

    def end(self, number: int, reason: str = "it was closed") -> None:
        """End a session and wait for it. Raises NotFoundError where there is none."""
        self.session(number).end(reason)
        with self._lock:
            self._sessions.pop(number, None)

    def close(self) -> None:
        """End all, and open no more."""
        with self._lock:
            self._closed = True
        for number in list(self._sessions):
            self.end(number, "the service ends")

    def _check_room(self) -> None:
        if self._closed:
            raise BusyError("the service ends.")
        open_now = [str(number) for number, each in self._sessions.items() if each.alive]
        if len(open_now) >= MOST:
            raise BusyError(f"relightings {', '.join(open_now)} are open, and {MOST} is the most: close one first.")
