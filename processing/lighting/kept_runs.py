"""Runs of numbers, one for each vertex, that are kept from frame to frame: step functions and lists of changes."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.lighting.rays import Bool

Int64 = NDArray[np.int64]
Column = NDArray[Any]


class KeptRuns:
    """Of `count` vertices, those that were added and not forgotten since; each column has a value of its type."""

    def __init__(self, count: int, *types: type) -> None:
        self._begin, self._end = np.zeros(count, np.int64), np.full(count, -1, np.int64)
        self.columns: tuple[Column, ...] = tuple(np.zeros(0, kind) for kind in types)
        self._used, self._turn = 0, 0

    @property
    def filled(self) -> tuple[int, int]:
        """A number of a turn, and how much of the columns is filled: within a turn it is only added to."""
        return self._turn, self._used

    def has(self, vertices: Int64) -> Bool:
        """Which of the vertices (n,) are kept."""
        return np.asarray(self._end[vertices] >= 0)

    def bounds(self, vertices: Int64) -> tuple[Int64, Int64]:
        """Where the runs (n,) of vertices that are all kept begin and end in `columns`, until the next are added."""
        return self._begin[vertices], self._end[vertices]

    def forget(self, mask: Bool) -> None:
        """Drop the vertices of a mask (count,)."""
        self._end[mask] = -1
        if not (self._end >= 0).any():
            self._used, self._turn = 0, self._turn + 1

    def keep(self, vertices: Int64, parts: Sequence[tuple[Int64, *tuple[Column, ...]]]) -> None:
        """Keep runs of vertices, part after part in their order: the sizes of a part's runs, then its columns."""
        new = sum(int(sizes.sum()) for sizes, *_ in parts)
        if self._used + new > len(self.columns[0]):
            self._make_room(new)
        first = 0
        for sizes, *columns in parts:
            those, ends = vertices[first : first + len(sizes)], self._used + np.cumsum(sizes)
            stop = int(ends[-1]) if len(ends) else self._used
            for kept, column in zip(self.columns, columns, strict=True):
                kept[self._used : stop] = column
            self._begin[those], self._end[those] = ends - sizes, ends
            first, self._used = first + len(sizes), stop

    def _make_room(self, new: int) -> None:
        """Leave out what is forgotten, and have room for a quarter more than is needed."""
        alive = np.flatnonzero(self._end >= 0)
        sizes = self._end[alive] - self._begin[alive]
        ends = np.cumsum(sizes)
        used = int(ends[-1]) if len(ends) else 0
        where = np.repeat(self._begin[alive] - (ends - sizes), sizes) + np.arange(used)
        room = used + new + (used + new) // 4 if used else new
        longer = tuple(np.empty(room, column.dtype) for column in self.columns)
        for kept, column in zip(longer, self.columns, strict=True):
            kept[:used] = column[where]
        self._begin[alive], self._end[alive] = ends - sizes, ends
        self.columns, self._used, self._turn = longer, used, self._turn + 1
