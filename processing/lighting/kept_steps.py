"""Step functions of vertices that are kept from frame to frame."""

import numpy as np
from numpy.typing import NDArray

from processing.lighting.moving_kernel import Steps
from processing.lighting.rays import Bool

Int64 = NDArray[np.int64]


class KeptSteps:
    """Of `count` vertices, those that were added and not forgotten since."""

    def __init__(self, count: int) -> None:
        self._begin, self._end = np.zeros(count, np.int64), np.full(count, -1, np.int64)
        self._start, self._value = np.zeros(0, np.uint16), np.zeros(0, np.float32)
        self._used, self._turn = 0, 0

    @property
    def filled(self) -> tuple[int, int]:
        """A number of a turn, and how much of what `steps` holds is filled: within a turn it is only added to."""
        return self._turn, self._used

    def has(self, vertices: Int64) -> Bool:
        """Which of the vertices (n,) are kept."""
        return np.asarray(self._end[vertices] >= 0)

    def forget(self, mask: Bool) -> None:
        """Drop the vertices of a mask (count,)."""
        self._end[mask] = -1
        if not (self._end >= 0).any():
            self._used, self._turn = 0, self._turn + 1

    def add(self, vertices: Int64, parts: list[Steps]) -> None:
        """Keep the steps of vertices, part after part in their order."""
        new = sum(len(part.start) for part in parts)
        if self._used + new > len(self._start):
            self._make_room(new)
        first = 0
        for part in parts:
            those, stop = vertices[first : first + len(part.begin)], self._used + len(part.start)
            self._start[self._used : stop], self._value[self._used : stop] = part.start, part.value
            self._begin[those], self._end[those] = self._used + part.begin, self._used + part.end
            first, self._used = first + len(part.begin), stop

    def steps(self, vertices: Int64) -> Steps:
        """Those of vertices that are all kept."""
        return Steps(self._begin[vertices], self._end[vertices], self._start, self._value)

    def _make_room(self, new: int) -> None:
        """Leave out what is forgotten, and have room for a quarter more than is needed."""
        alive = np.flatnonzero(self._end >= 0)
        sizes = self._end[alive] - self._begin[alive]
        ends = np.cumsum(sizes)
        used = int(ends[-1]) if len(ends) else 0
        where = np.repeat(self._begin[alive] - (ends - sizes), sizes) + np.arange(used)
        room = used + new + (used + new) // 4 if used else new
        start, value = np.empty(room, np.uint16), np.empty(room, np.float32)
        start[:used], value[:used] = self._start[where], self._value[where]
        self._begin[alive], self._end[alive] = ends - sizes, ends
        self._start, self._value, self._used, self._turn = start, value, used, self._turn + 1
