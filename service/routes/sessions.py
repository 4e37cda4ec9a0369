"""Sessions: start one, act on it, look at it and at its frames."""

from pathlib import Path
from typing import Any, Literal

from fastapi import APIRouter, Response

from rig.errors import StoreError
from rig.sessions import Session, allowed, parse_plan
from service.host import SessionHost
from service.pictures import frame_png
from service.pipeline.calibrations import SENSORS
from service.problems import NotFoundError
from service.routes.dependencies import Host

router = APIRouter(prefix="/sessions", tags=["sessions"])
OperatorAction = Literal["start", "pause", "resume", "stop", "abort", "acknowledge"]


@router.get("")
def list_sessions(host: Host) -> list[dict[str, Any]]:
    """Every session, newest first; of one that is damaged, or that was taken away a moment ago, what is wrong."""
    return [_entry(session_id, host) for session_id in host.ids()]


@router.post("", status_code=201)
def start_session(plan: dict[str, Any], host: Host, response: Response) -> dict[str, Any]:
    """Create a session from a plan and start it; Location names it. 409 while another one runs."""
    session_id = host.start(parse_plan(plan))
    response.headers["Location"] = f"/api/v1/sessions/{session_id}"
    return read_session(session_id, host)


@router.get("/{session_id}")
def read_session(session_id: str, host: Host) -> dict[str, Any]:
    """State, allowed actions and progress of one session."""
    with host.open(session_id) as session:
        state = host.state(session)
        return {
            "id": session_id, "kind": session.plan.kind, "state": state, "allowed": allowed(state),
            "done": len(session.done()), "total": len(session.steps),
            "products": _products(session.products),
        }  # fmt: skip


@router.post("/{session_id}/actions/{action}", status_code=202)
def act(session_id: str, action: OperatorAction, host: Host) -> dict[str, Any]:
    """Pause, resume, stop, abort, acknowledge or start again. 409 names the state and what is allowed in it."""
    host.act(session_id, action)
    return read_session(session_id, host)


@router.get("/{session_id}/frames")
def list_frames(session_id: str, host: Host, step: str | None = None) -> list[dict[str, Any]]:
    """Every durable frame, or those of one step, with its step, camera, exposure and checksum."""
    with host.open(session_id) as session:
        return [
            {"step": r.step.id, "camera": r.camera, "exposure_s": r.exposure_s, "frames": r.frames, "sha256": r.sha256}
            for r in session.frames() if step in (None, r.step.id)
        ]  # fmt: skip


@router.get("/{session_id}/frames/{step}/{camera}.png", response_class=Response)
def read_frame(session_id: str, step: str, camera: str, host: Host) -> Response:
    """One frame as a picture; of a burst the brightest moment of every pixel."""
    with host.open(session_id) as session:
        return Response(frame_png(_record_path(session, step, camera)), media_type="image/png")


def _products(folder: Path) -> list[str]:
    """Names of what was made; of sensors, one for each serial number, below a folder of their own."""
    found = [*folder.glob("*/product.json"), *folder.glob(f"{SENSORS}/*/product.json")]
    return sorted(path.parent.relative_to(folder).as_posix() for path in found)


def _entry(session_id: str, host: SessionHost) -> dict[str, Any]:
    try:
        return read_session(session_id, host)
    except (StoreError, NotFoundError) as error:
        return {
            "id": session_id, "kind": None, "state": "unreadable", "allowed": (), "done": 0, "total": 0,
            "products": [], "problem": str(error),
        }  # fmt: skip


def _record_path(session: Session, step: str, camera: str) -> Path:
    for record in session.frames():
        if (record.step.id, record.camera) == (step, camera):
            return record.path
    raise NotFoundError(f"session {session.id}: no frame of step {step!r} and camera {camera!r}.")
