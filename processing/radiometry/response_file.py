"""Responses of cameras, kept in files for further brackets of the same camera."""

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.radiometry.response import CODES, Response

_SCHEMA = "camera-response/1"
_TABLES = "log_exposure", "log_exposure_sigma", "code_sigma_dn"


def write_response(path: Path, response: Response) -> None:
    """Write the response as JSON; its tables list the channels one after the other, each with 256 codes."""
    tables = {name: np.round(getattr(response, name), 6).T.tolist() for name in _TABLES}
    coding = np.round(response.coding_sigma_dn, 6).tolist()
    content = {"schema": _SCHEMA, "camera": response.camera, **tables, "coding_sigma_dn": coding}
    try:
        path.write_text(json.dumps(content) + "\n", encoding="utf-8")
    except OSError as error:
        raise ImageError(f"{path}: cannot be written: {error.strerror}.") from error


def read_response(path: Path) -> Response:
    """Inverse of `write_response`. Raises ImageError that names the file where it is missing or holds none."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["schema"] != _SCHEMA:
            raise ValueError(f"schema {content['schema']!r}, not {_SCHEMA!r}")
        tables = [_table(content[name]) for name in _TABLES]
        coding = np.asarray(content["coding_sigma_dn"], np.float64)
        _check(tables, coding)
        curve, curve_sigma, code_sigma_dn = tables
        return Response(curve, curve_sigma, code_sigma_dn, coding, str(content["camera"]))
    except OSError as error:
        raise ImageError(f"{path}: cannot be read: {error.strerror}.") from error
    except (ValueError, KeyError, TypeError) as error:
        raise ImageError(f"{path}: not a response that rig merge saved ({error}). Save it anew.") from error


def _table(rows: object) -> NDArray[np.float64]:
    return np.ascontiguousarray(np.asarray(rows, np.float64).T)


def _check(tables: list[NDArray[np.float64]], coding: NDArray[np.float64]) -> None:
    shape = tables[0].shape
    if len(shape) != 2 or shape[0] != CODES or any(table.shape != shape for table in tables):
        raise ValueError("tables of the wrong size")
    if coding.shape != shape[1:] or not all(np.isfinite(table).all() for table in [*tables, coding]):
        raise ValueError("numbers are missing")
    if not ((np.diff(tables[0], axis=0) > 0).all() and (tables[2] > 0).all()):
        raise ValueError("a curve that does not rise, or codes without noise")
