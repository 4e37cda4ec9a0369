"""Background jobs of the service: one thread, one job at a time, with progress and cancel."""

import logging
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, TypeVar

from service.problems import DEFECT, NotFoundError, problem_of

Item = TypeVar("Item")

log = logging.getLogger(__name__)


@dataclass
class Job:
    """One job as its reader sees it; it is also the progress that the work reports to."""

    number: int
    title: str
    state: str = "waiting"
    stage: str = ""
    done: int = 0
    total: int | None = None
    problem: dict[str, str] | None = None
    notes: list[str] = field(default_factory=list)
    cancelled: threading.Event = field(default_factory=threading.Event)

    def track(self, items: Iterable[Item], description: str) -> Iterator[Item]:
        """Yield the items and count them; ends the work by CancelledError once the job is cancelled."""
        listed = list(items)
        self.stage, self.done, self.total = description, 0, len(listed)
        for item in listed:
            if self.cancelled.is_set():
                raise CancelledError
            yield item
            self.done += 1

    def note(self, text: str) -> None:
        """Keep it for the job's reader."""
        self.notes.append(text)


class Jobs:
    """All jobs since the service started."""

    def __init__(self) -> None:
        self._jobs: dict[int, Job] = {}
        self._lock = threading.Lock()
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="job")

    def submit(self, title: str, work: Callable[[Job], object]) -> int:
        """Queue a job and return its number."""
        with self._lock:
            job = Job(len(self._jobs) + 1, title)
            self._jobs[job.number] = job
        self._pool.submit(self._run, job, work)
        return job.number

    def read(self, number: int) -> dict[str, Any]:
        """A job's state. Raises NotFoundError where there is none."""
        job = self._job(number)
        return {
            "id": job.number, "title": job.title, "state": job.state, "stage": job.stage, "done": job.done,
            "total": job.total, "problem": job.problem, "notes": list(job.notes),
        }  # fmt: skip

    def cancel(self, number: int) -> None:
        """Ask a job to end; one that has ended stays as it is. Raises NotFoundError where there is none."""
        self._job(number).cancelled.set()

    def close(self) -> None:
        """Cancel everything and wait."""
        for job in list(self._jobs.values()):
            job.cancelled.set()
        self._pool.shutdown()

    def _job(self, number: int) -> Job:
        if number not in self._jobs:
            raise NotFoundError(f"no job {number}; jobs are forgotten when the service restarts.")
        return self._jobs[number]

    def _run(self, job: Job, work: Callable[[Job], object]) -> None:
        if job.cancelled.is_set():
            job.state = "cancelled"
            return
        job.state = "running"
        try:
            work(job)
        except CancelledError:
            job.state = "cancelled"
        except Exception as error:
            problem = problem_of(error)
            if problem is None:
                log.exception("job %d, %s", job.number, job.title)
            job.problem = {"code": (problem or DEFECT).code, "detail": str(error)}
            job.state = "failed"
        else:
            job.state = "finished"
