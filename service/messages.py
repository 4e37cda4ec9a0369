"""What a session tells, numbered, for readers that come late or come back."""

import threading
from collections import deque
from collections.abc import Mapping
from itertools import islice
from typing import Any

MOST_KEPT = 10_000  # of the newest; every message of progress says by itself how far the session is


class Messages:
    """Messages numbered from 1 by `sequence`; written by one thread and read by others. The newest ones are kept."""

    def __init__(self) -> None:
        self._kept: deque[dict[str, Any]] = deque(maxlen=MOST_KEPT)
        self._last = 0
        self._lock = threading.Lock()

    def add(self, message: Mapping[str, Any]) -> None:
        """Number a message and keep it."""
        with self._lock:
            self._last += 1
            self._kept.append({"sequence": self._last, **message})

    def after(self, sequence: int) -> list[dict[str, Any]]:
        """What was told since that number, in order; everything where the number is from an earlier life of the
        service. The first number tells a reader that was away for too long how many are missing."""
        with self._lock:
            known = sequence if 0 <= sequence <= self._last else 0
            before = self._last - len(self._kept)
            return list(islice(self._kept, max(known - before, 0), None))
