"""Who watches long work."""

from collections.abc import Iterable, Iterator
from typing import Protocol, TypeVar

Item = TypeVar("Item")


class Progress(Protocol):
    """Counts items while they are worked on."""

    def track(self, items: Iterable[Item], description: str) -> Iterator[Item]:
        """Yield the items."""


class Silence:
    """Progress that nobody looks at."""

    def track(self, items: Iterable[Item], description: str) -> Iterator[Item]:
        """Yield the items."""
        return iter(items)
