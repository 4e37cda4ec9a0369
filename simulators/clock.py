"""Simulated time: now = rate * wall time + jumps, and what is due in it, in time order.

Times inside are whole nanoseconds, so that the time between two events does not depend on when they happen.
"""

import heapq
import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass, field

NS_PER_S = 1_000_000_000


@dataclass(order=True, slots=True)
class Event:
    """Something due at a time; `cancel` takes it off the list."""

    time_ns: int
    order: int
    action: Callable[[], None] = field(compare=False)
    cancelled: bool = field(default=False, compare=False)

    def cancel(self) -> None:
        """Never mind; allowed also after the event has happened."""
        self.cancelled = True


class Clock:
    """One clock for all simulators.

    At rate 0 time moves only by `advance`: everything is deterministic. At another rate it also follows the wall, and
    whoever owns the clock calls `run_due` when `due_in_s` has passed.
    """

    def __init__(self, rate: float = 0.0, wall_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self.rate = rate
        self._wall_ns = wall_ns
        self._wall_start_ns = wall_ns()
        self._jumps_ns = 0
        self._events: list[Event] = []
        self._order = itertools.count()
        self._moment_ns: int | None = None

    def now_ns(self) -> int:
        """The time; within an event, that event's time."""
        return self._flowing_ns() if self._moment_ns is None else self._moment_ns

    def now_s(self) -> float:
        """The same in seconds."""
        return self.now_ns() / NS_PER_S

    def at(self, time_ns: int, action: Callable[[], None]) -> Event:
        """Have the action done at that time, or as soon as possible where it has passed."""
        event = Event(max(time_ns, self.now_ns()), next(self._order), action)
        heapq.heappush(self._events, event)
        return event

    def after(self, seconds: float, action: Callable[[], None]) -> Event:
        """Have the action done that long from now."""
        return self.at(self.now_ns() + round(seconds * NS_PER_S), action)

    def advance(self, seconds: float) -> None:
        """Jump ahead; all that falls due on the way happens first, in time order.

        Raises ValueError where the jump would go back.
        """
        if seconds < 0:
            raise ValueError(f"time cannot go back by {-seconds} s")
        self._jumps_ns += round(seconds * NS_PER_S)
        self.run_due()

    def run_due(self) -> None:
        """Do all that is due by now. Within an event nothing is done: the loop that runs the event goes on to it."""
        if self._moment_ns is not None:
            return
        try:
            while self._events and self._events[0].time_ns <= self._flowing_ns():
                event = heapq.heappop(self._events)
                if not event.cancelled:
                    self._moment_ns = event.time_ns
                    event.action()
        finally:
            self._moment_ns = None

    def due_in_s(self) -> float | None:
        """Wall time until the next event; None where waiting alone brings none."""
        if not self._events or self.rate == 0:
            return None
        return max(0.0, (self._events[0].time_ns - self._flowing_ns()) / NS_PER_S / self.rate)

    def _flowing_ns(self) -> int:
        return self._jumps_ns + round(self.rate * (self._wall_ns() - self._wall_start_ns))
