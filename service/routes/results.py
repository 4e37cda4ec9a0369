"""Results: the files of a session's products, and pictures of them."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Response
from fastapi.responses import FileResponse
from pydantic import BaseModel, Field
from starlette.exceptions import HTTPException

from service.routes.dependencies import Host
from service.viewing import draw_product

router = APIRouter(prefix="/sessions/{session_id}/products", tags=["results"])


class Look(BaseModel, extra="forbid"):
    """How a material is to be shown; the light's azimuth counts from +X toward +Y, its elevation from the horizon."""

    shape: Literal["", "sphere", "plane", "torus", "vase"] = ""
    azimuth_deg: float = 40.0
    elevation_deg: float = 45.0
    size: int = Field(default=600, ge=16, le=2048)


@router.get("")
def list_files(session_id: str, host: Host) -> list[str]:
    """Every file of the session's products, as paths below this address."""
    with host.open(session_id) as session:
        files = [path for path in session.products.rglob("*") if path.is_file()]
        return sorted(path.relative_to(session.products).as_posix() for path in files)


@router.get("/{name}/picture.png", response_class=Response)
def draw_picture(session_id: str, name: str, look: Annotated[Look, Query()], host: Host) -> Response:
    """A product as a picture: a material on a shape under one light, or what was measured."""
    with host.open(session_id) as session, TemporaryDirectory() as folder:
        picture = Path(folder) / "picture.png"
        light_deg = (look.azimuth_deg, look.elevation_deg)
        draw_product(session.products / Path(name).name, picture, look.shape, light_deg, look.size)
        return Response(picture.read_bytes(), media_type="image/png")


@router.get("/{path:path}", response_class=FileResponse)
def read_file(session_id: str, path: str, host: Host) -> FileResponse:
    """One file of a product, pictures among them."""
    with host.open(session_id) as session:
        root = session.products.resolve()
        wanted = (root / path).resolve()
    if not wanted.is_relative_to(root) or not wanted.is_file():
        raise HTTPException(404, f"session {session_id} has no product file {Path(path).as_posix()!r}.")
    return FileResponse(wanted)
