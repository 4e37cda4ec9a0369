"""Makes frames durable in a thread of its own while the rig moves on. It never touches a device or the rig's clock."""

import queue
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

from rig.interrupts import postponed
from rig.sessions import store
from rig.sessions.checks import Shot
from rig.sessions.journal import FrameEntry
from rig.sessions.step import Step

_WAITING_SHOTS = 4  # a burst of a full-size camera is 145 MB


@dataclass(frozen=True, eq=False)
class Capture:
    """One attempt at a step, and what its cameras' entries have in common."""

    step: Step
    utc: str
    commanded_rad: Mapping[str, float]
    reported_rad: Mapping[str, float]
    entries: list[FrameEntry] = field(default_factory=list)


class Writer:
    """A bounded queue and the thread that empties it; a context that ends when all of it is on disk.

    `on_durable` gets a step's id and its entries once all of its frames are on disk.
    After the first error it writes nothing more; the error is raised by the next `put` or `drain`.
    """

    def __init__(self, folder: Path, on_durable: Callable[[str, Sequence[FrameEntry]], None]) -> None:
        self._folder = folder
        self._on_durable = on_durable
        self._queue: queue.Queue[tuple[Capture, Shot] | None] = queue.Queue(_WAITING_SHOTS)
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._work, name="frame writer", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._hand_over(None)
        self._thread.join()

    def put(self, capture: Capture, shot: Shot) -> None:
        """Hand a shot over; waits while the queue is full. Raises the writer's error."""
        self._check()
        self._hand_over((capture, shot))

    def drain(self) -> None:
        """Wait until everything handed over is durable. Raises the writer's error."""
        self._queue.join()
        self._check()

    def _hand_over(self, job: tuple[Capture, Shot] | None) -> None:
        # A Ctrl-C in the middle of the queue's own notification would leave the thread asleep for ever.
        with postponed():
            self._queue.put(job)

    def _check(self) -> None:
        if self._error is not None:
            raise self._error

    def _work(self) -> None:
        while (job := self._queue.get()) is not None:
            try:
                if self._error is None:
                    self._write(*job)
            except BaseException as error:  # noqa: BLE001 - handed to the control thread, which raises it
                self._error = error
            finally:
                self._queue.task_done()
        self._queue.task_done()

    def _write(self, capture: Capture, shot: Shot) -> None:
        step = capture.step
        relative = Path("frames", step.id, f"{shot.camera}.{shot.file_format if shot.burst is None else 'zarr'}")
        if shot.burst is None:
            stored = store.write_file(self._folder / relative, shot.data or b"")
        else:
            stored = store.write_burst(self._folder / relative, shot.burst, shot.attributes)
        capture.entries.append(FrameEntry(
            step.id, shot.camera, str(relative), stored.sha256, stored.bytes, shot.exposure_s, shot.frames,
            shot.taken_s, capture.utc, capture.commanded_rad, capture.reported_rad,
        ))  # fmt: skip
        if len(capture.entries) == len(step.cameras):
            self._on_durable(step.id, capture.entries)
