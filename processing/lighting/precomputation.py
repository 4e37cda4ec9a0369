"""A body's self-visibility and visibility field, computed once: results lie in a folder, named by what they are of.

Files are written whole or not at all, and computed again where they are damaged.
"""

import hashlib
import io
import json
import os
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TypeVar
from zipfile import BadZipFile, ZipFile

import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.lighting.coding import cuts_from_disk, cuts_to_disk, toggles_from_disk, toggles_to_disk
from processing.lighting.cuts import Cuts
from processing.lighting.directions import SampleDirections
from processing.lighting.field import FieldTracer, VisibilityField, block_size
from processing.lighting.outline import FlatOutline, flat_outline
from processing.lighting.self_visibility import self_visibility
from processing.lighting.shells import ShellPlan, Shells
from processing.lighting.triangle_body import TriangleBody
from processing.progress import Progress, Silence
from processing.threads import in_parts

VERSION = 1  # of what is computed: another one leaves what earlier ones wrote alone
TOLERANCE = 0.008

_ABOUT = "about.json"
_UNREADABLE = (OSError, ValueError, KeyError, EOFError, TypeError, BadZipFile, zlib.error, ImageError)

Found = TypeVar("Found")


@dataclass(frozen=True)
class Cost:
    """Rays that were traced, seconds that it took when it was computed, and bytes of the file."""

    rays: int
    seconds: float
    disk_bytes: int


@dataclass(frozen=True, eq=False)
class PrecomputedBody:
    """A body with the cuts of its vertices and the field around it, or a flat one's outline, in its vertices' frame."""

    body: TriangleBody
    self_visibility: Cuts
    field: VisibilityField | FlatOutline


def precompute(
    body: TriangleBody,
    sampled: SampleDirections,
    folder: Path,
    report: Progress | None = None,
    *,
    tolerance: float = TOLERANCE,
    shells: ShellPlan | None = None,
) -> PrecomputedBody:
    """Both of a body that catches light and casts shadows; `folder` keeps them."""
    cuts, _ = cached_self_visibility(body, sampled, folder, report, tolerance=tolerance)
    return PrecomputedBody(body, cuts, outline_or_field(body, sampled, folder, report, shells=shells))


def outline_or_field(
    body: TriangleBody,
    sampled: SampleDirections,
    folder: Path,
    report: Progress | None = None,
    *,
    shells: ShellPlan | None = None,
) -> VisibilityField | FlatOutline:
    """What tells the shadows that a body casts: a flat one's outline, which is exact, or the field of any other."""
    return flat_outline(body) or cached_field(body, sampled, folder, report, shells=shells)[0]


def cached_self_visibility(
    body: TriangleBody,
    sampled: SampleDirections,
    folder: Path,
    report: Progress | None = None,
    *,
    tolerance: float = TOLERANCE,
) -> tuple[Cuts, Cost]:
    """Self-visibility cuts of a body's vertices (see `self_visibility`), values in two bytes, and their cost."""
    key = _digest(sampled.digest, tolerance, body.vertices, body.normals, body.triangles)

    def compute(file: ZipFile) -> None:
        begun = time.perf_counter()
        cuts, rays = self_visibility(body, sampled, tolerance, report)
        file.writestr("cuts", cuts_to_disk(cuts, sampled.height))
        _write_about(file, {"rays": rays, "seconds": time.perf_counter() - begun})

    def read(file: ZipFile) -> Cuts:
        return cuts_from_disk(file.read("cuts"), sampled.height)

    return _cached(folder / f"svc-{key}.zip", compute, read)


def cached_field(
    body: TriangleBody,
    sampled: SampleDirections,
    folder: Path,
    report: Progress | None = None,
    *,
    shells: ShellPlan | None = None,
) -> tuple[VisibilityField, Cost]:
    """The visibility field of a body and its cost. While it is computed, one sphere of points is in memory."""
    plan = shells or ShellPlan()
    key = _digest(sampled.digest, json.dumps(asdict(plan)), body.vertices[body.triangles])
    around = plan.around(body.centre, body.radius)

    def compute(file: ZipFile) -> None:
        _write_field(file, FieldTracer(body, sampled, around), around, sampled.height, report or Silence())

    def read(file: ZipFile) -> VisibilityField:
        return _read_field(file, around, sampled.height)

    return _cached(folder / f"vcf-{key}.zip", compute, read)


def _write_field(file: ZipFile, tracer: FieldTracer, shells: Shells, height: int, report: Progress) -> None:
    begun, step, rays, sizes = time.perf_counter(), block_size(shells), 0, list[int]()
    for start in report.track(range(0, len(shells), step), "visibility field"):
        block = tracer.trace(start, start + step)
        first = np.concatenate([[0], np.cumsum(block.counts)])
        file.writestr(str(len(sizes)), toggles_to_disk(first, block.toggles, height))
        rays += block.rays
        sizes.append(int(first[-1]))
    _write_about(file, {"rays": rays, "seconds": time.perf_counter() - begun, "toggles": sizes})


def _read_field(file: ZipFile, shells: Shells, height: int) -> VisibilityField:
    sizes, step = json.loads(file.read(_ABOUT))["toggles"], block_size(shells)
    ends = np.concatenate([[0], np.cumsum(sizes)])
    first, toggles = np.zeros(len(shells) + 1, np.int64), np.empty(ends[-1], np.uint16)
    codes = [file.read(str(block)) for block in range(len(sizes))]

    def decode(start: int, stop: int) -> None:
        for block in range(start, stop):
            bounds, found = toggles_from_disk(codes[block], step, height)
            first[block * step + 1 : (block + 1) * step + 1] = ends[block] + bounds[1:]
            toggles[ends[block] : ends[block + 1]] = found

    in_parts(decode, len(codes), 1)
    return VisibilityField(shells, height, first, toggles)


def _cached(path: Path, compute: Callable[[ZipFile], None], read: Callable[[ZipFile], Found]) -> tuple[Found, Cost]:
    """What the file holds, after computing it where there is none that can be read."""
    try:
        return _read(path, read)
    except _UNREADABLE:
        path.parent.mkdir(parents=True, exist_ok=True)
        with _whole(path) as file:
            compute(file)
        return _read(path, read)


def _read(path: Path, read: Callable[[ZipFile], Found]) -> tuple[Found, Cost]:
    with ZipFile(path) as file:
        about = json.loads(file.read(_ABOUT))
        return read(file), Cost(int(about["rays"]), float(about["seconds"]), path.stat().st_size)


@contextmanager
def _whole(path: Path) -> Iterator[ZipFile]:
    """A file that takes its name when it is finished; processes that write the same one do not meet."""
    partial = path.with_suffix(f".{os.getpid()}.partial")
    try:
        with ZipFile(partial, "w") as file:
            yield file
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def _write_about(file: ZipFile, about: dict[str, object]) -> None:
    file.writestr(_ABOUT, json.dumps({"version": VERSION, **about}))


def _digest(*parts: str | float | NDArray[np.generic]) -> str:
    """What tells these inputs from any other."""
    found = hashlib.sha256(f"{VERSION}".encode())
    for part in parts:
        stored = io.BytesIO()
        np.save(stored, np.asarray(part))  # with its shape and type
        found.update(stored.getbuffer())
    return found.hexdigest()[:32]
