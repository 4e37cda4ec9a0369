"""What every product folder says about itself: kind, schema, versions, and what it was made from."""

import json
import zlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError

SCHEMA = 1
DESCRIPTION = "product.json"
_LIBRARIES = ("appearance-rig", "numpy", "scipy", "zarr", "OpenEXR")


@dataclass(frozen=True)
class Provenance:
    """What a product was made from.

    `frames` are identities of the frames (or the name of the session), `calibration` the identity of the
    calibration, `parameters` the settings of the processing; all of it must be JSON.
    """

    frames: tuple[str, ...] = ()
    calibration: str = ""
    parameters: dict[str, Any] = field(default_factory=dict)


def versions() -> dict[str, str]:
    """Versions of this distribution and of the libraries that decide the numbers."""
    found = {}
    for name in _LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def write_description(folder: Path, kind: str, content: dict[str, Any], provenance: Provenance) -> None:
    """Write product.json; called last, so that a folder that has one is whole."""
    description = {
        "kind": kind,
        "schema": SCHEMA,
        "versions": versions(),
        "provenance": asdict(provenance),
        "content": content,
    }
    (folder / DESCRIPTION).write_text(json.dumps(description, indent=2) + "\n", encoding="utf-8")


def read_arrays(path: Path, names: Sequence[str]) -> list[NDArray[Any]]:
    """Arrays of an .npz file by name; raises ImageError that names it where it is missing, damaged or lacks one."""
    try:
        with path.open("rb") as file, np.load(file) as stored:  # np.load itself leaves a damaged file open
            return [stored[name] for name in names]
    except (OSError, ValueError, EOFError, KeyError, BadZipFile, zlib.error) as error:
        raise ImageError(f"{path}: not a whole file of arrays ({error}); process the session again") from error


def read_description(folder: Path, kind: str) -> tuple[dict[str, Any], Provenance]:
    """Content and provenance of the product in `folder`; raises ImageError where it is not one of this kind."""
    path = folder / DESCRIPTION
    try:
        description = json.loads(path.read_text(encoding="utf-8"))
        found = (description["kind"], description["schema"])
        given = description["provenance"]
        provenance = Provenance(tuple(given["frames"]), given["calibration"], given["parameters"])
        content: dict[str, Any] = description["content"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ImageError(f"{path}: not the description of a product; process the session again") from error
    if found != (kind, SCHEMA):
        raise ImageError(f"{path}: expected a {kind} of schema {SCHEMA}, found {found[0]} of schema {found[1]}")
    return content, provenance
