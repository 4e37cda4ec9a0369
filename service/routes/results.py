"""Results: the files of a session's products, and pictures of them."""

from pathlib import Path

from fastapi import APIRouter
from fastapi.responses import FileResponse
from starlette.exceptions import HTTPException

from service.routes.dependencies import Host

router = APIRouter(prefix="/sessions/{session_id}/products", tags=["results"])


@router.get("")
def list_files(session_id: str, host: Host) -> list[str]:
    """Every file of the session's products, as paths below this address."""
    with host.open(session_id) as session:
        files = [path for path in session.products.rglob("*") if path.is_file()]
        return sorted(path.relative_to(session.products).as_posix() for path in files)


@router.get("/{path:path}", response_class=FileResponse)
def read_file(session_id: str, path: str, host: Host) -> FileResponse:
    """One file of a product, pictures among them."""
    with host.open(session_id) as session:
        root = session.products.resolve()
        wanted = (root / path).resolve()
    if not wanted.is_relative_to(root) or not wanted.is_file():
        raise HTTPException(404, f"session {session_id} has no product file {Path(path).as_posix()!r}.")
    return FileResponse(wanted)
