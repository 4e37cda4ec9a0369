"""The REST service under /api/v1: every route parses, calls one thing, and returns."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from http import HTTPStatus
from pathlib import Path

from fastapi import FastAPI, Request, WebSocket, WebSocketDisconnect
from fastapi.exceptions import RequestValidationError
from fastapi.responses import HTMLResponse, JSONResponse
from starlette.exceptions import HTTPException
from starlette.middleware.trustedhost import TrustedHostMiddleware

from rig.config import RigConfig
from service.host import SessionHost
from service.jobs import Jobs
from service.machine import versions
from service.problems import PROBLEMS, problem_of
from service.routes import devices, jobs, plans, results, sessions

API = "/api/v1"
LOCAL_HOSTS = ["127.0.0.1", "localhost", "[::1]", "testserver"]
WEB = Path(__file__).parent / "web"


def create_app(config: RigConfig, sessions_folder: Path) -> FastAPI:
    """The application for one rig and one folder of sessions; what runs ends safely when the application does."""
    app = interface()
    app.state.host = SessionHost(config, sessions_folder)
    app.state.jobs = Jobs()
    return app


def interface() -> FastAPI:
    """All routes and error bodies, without a rig."""
    app = FastAPI(
        title="appearance-rig", version=versions()["appearance-rig"], lifespan=_lifespan,
        description="Capture sessions, devices and results of one rig. Errors are problem+json (RFC 9457).",
        openapi_url=f"{API}/openapi.json", docs_url=f"{API}/docs", redoc_url=None,
    )  # fmt: skip
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=LOCAL_HOSTS)  # against DNS rebinding
    for module in (devices, plans, sessions, jobs, results):
        app.include_router(module.router, prefix=API)
    app.add_api_websocket_route(f"{API}/sessions/{{session_id}}/events", follow_events)
    app.add_api_route("/", start_page, response_class=HTMLResponse, include_in_schema=False)
    _report_problems(app)
    return app


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    yield
    await asyncio.to_thread(app.state.jobs.close)
    await asyncio.to_thread(app.state.host.close)


async def start_page() -> str:
    """The start page: sessions and their live progress."""
    return await asyncio.to_thread((WEB / "index.html").read_text, encoding="utf-8")


async def follow_events(socket: WebSocket, session_id: str, after: int = 0) -> None:
    """Numbered messages of a session as they come, from the one behind `after`: a reader that lost its connection
    loses nothing."""
    host: SessionHost = socket.app.state.host
    await socket.accept()
    if session_id not in await asyncio.to_thread(host.ids):
        await socket.close(4004, f"no session {session_id!r}")
        return
    while True:
        for message in host.messages(session_id, after):
            await socket.send_json(message)
            after = int(message["sequence"])
        try:
            await asyncio.wait_for(socket.receive_text(), timeout=0.1)  # also notices that the reader is gone
        except TimeoutError:
            continue
        except WebSocketDisconnect:
            return


def _report_problems(app: FastAPI) -> None:
    """Every error body is problem+json with a stable code."""

    async def expected(request: Request, error: Exception) -> JSONResponse:
        problem = problem_of(error)
        assert problem is not None
        return _problem(problem.status, problem.code, str(error))

    async def malformed(request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, RequestValidationError)
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        return _problem(422, "malformed-request", f"{where}: {first['msg']}")

    async def refused(request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, HTTPException)
        code = HTTPStatus(error.status_code).phrase.lower().replace(" ", "-")
        return _problem(error.status_code, code, str(error.detail))

    for kind in PROBLEMS:
        app.add_exception_handler(kind, expected)
    app.add_exception_handler(RequestValidationError, malformed)
    app.add_exception_handler(HTTPException, refused)


def _problem(status: int, code: str, detail: str) -> JSONResponse:
    body = {"type": f"/problems/{code}", "title": HTTPStatus(status).phrase, "status": status, "code": code,
            "detail": detail}  # fmt: skip
    return JSONResponse(body, status, media_type="application/problem+json")
