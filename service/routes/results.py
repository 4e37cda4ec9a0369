"""Results: the files of a session's products, and pictures of them."""

import threading
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Response
from fastapi.responses import FileResponse
from pydantic import BaseModel, Field

from service.host import SessionHost
from service.problems import NotFoundError
from service.routes.dependencies import Host
from service.viewing import draw_product, lights_of

router = APIRouter(prefix="/sessions/{session_id}/products", tags=["results"])
# One picture at a time: each takes all cores and up to a gigabyte.
_drawing = threading.Lock()


class Look(BaseModel, extra="forbid", allow_inf_nan=False):
    """How a material is to be shown; the light's azimuth counts from +X toward +Y, its elevation from the horizon."""

    shape: Literal["", "sphere", "plane", "torus", "cylinder", "knot", "vase", "statue"] = ""
    azimuth_deg: float = 40.0
    elevation_deg: float = 45.0
    size: int = Field(default=600, ge=16, le=2048)


@router.get("")
def list_files(session_id: str, host: Host) -> list[str]:
    """Every file of the session's products, as paths below this address."""
    root = _products(session_id, host)
    files = [path for path in root.rglob("*") if path.is_file() and not path.is_symlink()]
    return sorted(path.relative_to(root).as_posix() for path in files)


@router.get("/{name}/picture.png", response_class=Response)
def draw_picture(session_id: str, name: str, look: Annotated[Look, Query()], host: Host) -> Response:
    """A product as a picture: a material on a shape under one light, or what was measured."""
    product = product_file(session_id, f"{name}/product.json", host).parent
    lights = lights_of(look.azimuth_deg, look.elevation_deg, None)
    with _drawing, TemporaryDirectory() as folder:
        picture = Path(folder) / "picture.png"
        draw_product(product, picture, look.shape, lights, look.size)
        return Response(picture.read_bytes(), media_type="image/png")


@router.get("/{path:path}", response_class=FileResponse)
def read_file(session_id: str, path: str, host: Host) -> FileResponse:
    """One file of a product, pictures among them."""
    return FileResponse(product_file(session_id, path, host))


def _products(session_id: str, host: SessionHost) -> Path:
    return (host.folder_of(session_id) / "products").resolve()


def product_file(session_id: str, path: str, host: SessionHost) -> Path:
    """A file of the products. Raises NotFoundError for what is none, and for what leads out of them."""
    root = _products(session_id, host)
    with suppress(OSError, ValueError):  # no name of a file: too long, or with a zero in it
        wanted = (root / path).resolve()
        if wanted.is_relative_to(root) and wanted.is_file():
            return wanted
    raise NotFoundError(f"session {session_id} has no product file {path!r}.")
