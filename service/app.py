"""The REST service under /api/v1: every route parses, calls one thing, and returns."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path

from fastapi import FastAPI, WebSocket, WebSocketDisconnect
from fastapi.responses import FileResponse, HTMLResponse

from rig.config import RigConfig
from service.guard import Guard
from service.host import SessionHost
from service.jobs import Jobs
from service.machine import versions
from service.problem_json import report_problems
from service.relightings import Relightings
from service.routes import devices, jobs, plans, relightings, results, sessions
from service.scene_folder import SceneFolder

API = "/api/v1"
WEB = Path(__file__).parent / "web"
SCENES = Path("scenes")
PRECOMPUTED = ".precomputed"  # in the folder of the sessions, which it is no session of
NO_SESSION = 4004  # of the codes that a WebSocket leaves to its application


def create_app(config: RigConfig, sessions_folder: Path, scenes_folder: Path = SCENES) -> FastAPI:
    """The application for one rig and its folders of sessions and of scenes; what runs ends safely when the
    application does."""
    app = interface()
    app.state.host = SessionHost(config, sessions_folder)
    app.state.jobs = Jobs()
    app.state.scenes = SceneFolder(scenes_folder, sessions_folder)
    app.state.relightings = Relightings(sessions_folder / PRECOMPUTED, app.state.jobs)
    return app


def interface() -> FastAPI:
    """All routes and error bodies, without a rig."""
    app = FastAPI(
        title="appearance-rig", version=versions()["appearance-rig"], lifespan=_lifespan,
        description="Capture sessions, devices and results of one rig. Errors are problem+json (RFC 9457).",
        openapi_url=f"{API}/openapi.json", docs_url=f"{API}/docs", redoc_url=None,
    )  # fmt: skip
    app.add_middleware(Guard)
    for module in (devices, plans, sessions, jobs, results, relightings):
        app.include_router(module.router, prefix=API)
    app.add_api_websocket_route(f"{API}/sessions/{{session_id}}/events", follow_events)
    app.add_api_websocket_route(f"{API}/relightings/{{number}}/frames", relightings.follow_frames)
    app.add_api_route("/", start_page, response_class=HTMLResponse, include_in_schema=False)
    app.add_api_route("/light.js", light_script, include_in_schema=False)
    report_problems(app)
    return app


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    yield
    await asyncio.to_thread(app.state.host.close)  # first: a job may take minutes to its next step
    await asyncio.to_thread(app.state.relightings.close)
    await asyncio.to_thread(app.state.jobs.close)


async def start_page() -> HTMLResponse:
    """The start page: sessions and their live progress. No other site may show it in a frame of its own."""
    page = await asyncio.to_thread((WEB / "index.html").read_text, encoding="utf-8")
    return HTMLResponse(page, headers={"Content-Security-Policy": "frame-ancestors 'none'"})


async def light_script() -> FileResponse:
    """The start page's part about light."""
    return FileResponse(WEB / "light.js", media_type="text/javascript")


async def follow_events(socket: WebSocket, session_id: str, after: int = 0) -> None:
    """Numbered messages of a session as they come, from the one behind `after`: a reader that lost its connection
    loses nothing."""
    host: SessionHost = socket.app.state.host
    await socket.accept()
    if session_id not in await asyncio.to_thread(host.ids):
        await socket.close(NO_SESSION, f"no session {session_id!r}")
        return
    with suppress(WebSocketDisconnect):
        while True:
            for message in host.messages(session_id, after):
                await socket.send_json(message)
                after = int(message["sequence"])
            await _pause(socket)


async def _pause(socket: WebSocket) -> None:
    """Let a moment pass. Raises WebSocketDisconnect where the reader is gone; what readers say is not for us."""
    with suppress(TimeoutError):
        message = await asyncio.wait_for(socket.receive(), timeout=0.1)
        if message["type"] == "websocket.disconnect":
            raise WebSocketDisconnect
