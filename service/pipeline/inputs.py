"""What a product was made from, and whether that is still what would go into it."""

import hashlib
import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Protocol, TypeVar

from processing.products import Provenance
from rig.sessions import FrameRecord, Session

Item = TypeVar("Item")


class Progress(Protocol):
    """Whoever watches: a bar, a job, or nobody."""

    def track(self, items: Iterable[Item], description: str) -> Iterator[Item]:
        """Yield the items while showing how far along they are."""
        ...

    def note(self, text: str) -> None:
        """Tell something that the results rest on and that whoever watches should know."""
        ...


def fingerprint(records: Iterable[FrameRecord], parameters: dict[str, object]) -> dict[str, object]:
    """What a product is made from: a digest of its frames, and its parameters."""
    frames = hashlib.sha256("".join(sorted(record.sha256 for record in records)).encode()).hexdigest()
    return {"frames_sha256": frames, **parameters}


def is_current(folder: Path, inputs: dict[str, object]) -> bool:
    """Whether the product in this folder was made from exactly these inputs, so that nothing needs to be done."""
    try:
        described = json.loads((folder / "product.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return bool(described.get("provenance", {}).get("parameters") == json.loads(json.dumps(inputs)))


def provenance(session: Session, inputs: dict[str, object]) -> Provenance:
    """Where a product of this session comes from."""
    return Provenance((session.id,), str(inputs.get("calibrations", "")), inputs)
