"""Photographs of a place from any camera: which bracket is the front's and which the back's."""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Self

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from processing.cameras.lens import Fisheye
from processing.environment.brackets import Bracket
from processing.errors import ImageError
from processing.formats import exif
from processing.formats.sequence import PICTURES, natural_order
from processing.radiometry.bracket import RAW_SUFFIXES

_Row = tuple[float, float, float]
PANORAMAS = (".exr", ".hdr", ".pic")
_SAME = 1.05  # exposures nearer to each other are one
_LEAST = 2  # photographs to a bracket


@dataclass(frozen=True, slots=True)
class _Shot:
    path: Path
    exposure: float
    taken_s: float


def panorama_among(sources: list[Path]) -> Path | None:
    """The panorama that was named, None where it is photographs. Raises ImageError for a panorama beside others."""
    panoramas = [path for path in sources if path.suffix.lower() in PANORAMAS]
    if panoramas and len(sources) > 1:
        raise ImageError(f"{panoramas[0]}: a panorama is the whole environment; leave the other names out.")
    return panoramas[0] if panoramas else None


class _LensFile(BaseModel):
    """What OpenCV's `fisheye.calibrate` gives: the camera matrix K in pixels, and k1 k2 k3 k4."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    matrix: tuple[_Row, _Row, _Row]
    distortion: tuple[float, float, float, float]

    @model_validator(mode="after")
    def _is_a_camera(self) -> Self:
        matrix = np.array(self.matrix)
        if not ((np.diag(matrix) > 0).all() and matrix[0, 1] == matrix[1, 0] == 0 and (matrix[2] == [0, 0, 1]).all()):
            raise ValueError("the matrix is not [[fu, 0, cu], [0, fv, cv], [0, 0, 1]]")
        return self


def read_lens(path: Path) -> Fisheye:
    """A calibrated fish-eye from a JSON file of `matrix` and `distortion`. Raises ImageError for another."""
    try:
        lens = _LensFile.model_validate_json(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ImageError(f"{path}: cannot be read: {error.strerror}.") from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        told = f"{path}: no fish-eye lens, a JSON of matrix and distortion"
        raise ImageError(f"{told}: {where} {first['msg']}.") from error
    return Fisheye(np.array(lens.matrix), np.array(lens.distortion))


def halved_lens(lens: Fisheye) -> Fisheye:
    """The same lens before half as many pixels, each the mean of four."""
    matrix = lens.matrix.copy()
    matrix[:2, 2] += 0.5
    matrix[:2] /= 2
    matrix[:2, 2] -= 0.5
    return Fisheye(matrix, lens.distortion)


def brackets_of(sources: list[Path]) -> tuple[Bracket, Bracket]:
    """Front and back: two folders in this order, or the photographs of one folder or of all names, told apart.

    Raises ImageError where something is missing or photographs cannot be told apart.
    """
    if missing := [path for path in sources if not path.exists()]:
        raise ImageError(f"{missing[0]}: no such file or folder.")
    folders = [path for path in sources if path.is_dir()]
    if len(sources) == len(folders) == 2:
        front, back = (_photographs(folder) for folder in folders)
        return Bracket(front), Bracket(back)
    if not folders:
        return _told_apart(tuple(sorted(sources, key=natural_order)))
    if len(sources) == 1:
        return _told_apart(_photographs(folders[0]))
    raise ImageError("two folders, front and back, or one folder, or photographs alone are needed, not a mixture.")


def _photographs(folder: Path) -> tuple[Path, ...]:
    # Hidden files are no pictures: copies from other systems leave some with a picture's ending.
    named = (path for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))
    found = [path for path in named if path.suffix.lower() in RAW_SUFFIXES | set(PICTURES)]
    if not found:
        raise ImageError(f"{folder}: no photographs in it (JPEG with EXIF, RAW or DNG).")
    return tuple(sorted(found, key=natural_order))


def _told_apart(files: tuple[Path, ...]) -> tuple[Bracket, Bracket]:
    """In the order of time, or of names where no time is told: the cut after which exposures start anew.

    A bracket holds every exposure once; where several cuts would do, the longest pause between photographs decides.
    """
    shots = [_shot(path) for path in files]
    if all(np.isfinite(shot.taken_s) for shot in shots):
        shots.sort(key=lambda shot: shot.taken_s)
    cuts = [i for i in range(_LEAST, len(shots) - _LEAST + 1) if _once(shots[:i]) and _once(shots[i:])]
    pauses = [np.nan_to_num(shots[i].taken_s - shots[i - 1].taken_s) for i in cuts]
    longest = sorted(pauses)[-2:]
    if not cuts or (len(cuts) > 1 and longest[0] == longest[1]):
        raise ImageError(
            f"{len(files)} photographs, {files[0].name} to {files[-1].name}: times and exposures do not tell which are "
            "the front's and which the back's. Put them into two folders and name both, the front first."
        )
    cut = cuts[int(np.argmax(pauses))]
    front, back = (tuple(shot.path for shot in part) for part in (shots[:cut], shots[cut:]))
    return Bracket(front), Bracket(back)


def _shot(path: Path) -> _Shot:
    tags = exif.read_tags(path.read_bytes())
    time_s = exif.exposure_s(tags)
    if not time_s > 0:
        raise ImageError(f"{path}: no exposure time in its EXIF data. Use the camera's own files, unedited.")
    iso, f_number = exif.number(tags, "ISOSpeedRatings"), exif.number(tags, "FNumber")
    exposure = time_s * (iso if iso > 0 else 1.0) / (f_number**2 if f_number > 0 else 1.0)
    return _Shot(path, exposure, exif.taken_s(tags))


def _once(shots: list[_Shot]) -> bool:
    exposures = sorted(shot.exposure for shot in shots)
    return all(longer > _SAME * shorter for shorter, longer in pairwise(exposures))
