"""Relightings: scenes under the light of a place, which clients look at and change while they are open."""

import asyncio
from contextlib import suppress
from typing import Any, Literal

from fastapi import APIRouter, Response, WebSocket, WebSocketDisconnect
from pydantic import BaseModel

from rig.errors import ConfigError
from service.problems import NotFoundError
from service.relightings import Relightings
from service.relit_messages import read_change
from service.relit_session import RelightingSession, Told, problem_told
from service.routes.dependencies import Host, RelightingList, Scenes
from service.routes.results import product_file

router = APIRouter(tags=["relightings"])
NO_RELIGHTING = 4004  # of the codes that a WebSocket leaves to its application
Shape = Literal["sphere", "torus", "cylinder", "knot", "vase", "statue", "teapot"]


class SceneWanted(BaseModel, extra="forbid"):
    """A scene of the folder of scenes, by its file's name."""

    scene: str


class ProductWanted(BaseModel, extra="forbid"):
    """A session's product, an SRF or SBRDF+, on a shape, under an environment by its name."""

    session: str
    product: str
    environment: str
    shape: Shape = "vase"


@router.get("/scenes")
def list_scenes(scenes: Scenes) -> dict[str, list[str]]:
    """Names of the scenes and of the environments that a relighting can be opened with."""
    return {"scenes": scenes.scenes(), "environments": list(scenes.environments())}


@router.get("/relightings")
def list_relightings(relightings: RelightingList) -> list[dict[str, Any]]:
    """Every relighting that is open, and those that ended since one was opened last."""
    return relightings.list()


@router.post("/relightings", status_code=201)
def open_relighting(
    wanted: SceneWanted | ProductWanted, relightings: RelightingList, scenes: Scenes, host: Host, response: Response
) -> dict[str, Any]:
    """Open a relighting: its job precomputes, its WebSocket /frames shows and changes it. 409 for too many."""
    if isinstance(wanted, SceneWanted):
        number = relightings.open(wanted.scene, lambda: scenes.open(wanted.scene))
    else:
        folder = product_file(wanted.session, f"{wanted.product}/product.json", host).parent
        title = f"{wanted.product} of {wanted.session}"
        number = relightings.open(title, lambda: scenes.with_product(folder, wanted.shape, wanted.environment))
    response.headers["Location"] = f"/api/v1/relightings/{number}"
    return relightings.read(number)


@router.get("/relightings/{number}")
def read_relighting(number: int, relightings: RelightingList) -> dict[str, Any]:
    """State, progress, the names that can be said to it, and the scene as it stands."""
    return relightings.read(number)


@router.delete("/relightings/{number}", status_code=204)
def close_relighting(number: int, relightings: RelightingList) -> None:
    """End a relighting; when this returns its graphics context is gone."""
    relightings.end(number)


async def follow_frames(socket: WebSocket, number: int) -> None:
    """What a relighting tells, and changes that are told to it: see docs/design-the-light.md."""
    relightings: Relightings = socket.app.state.relightings
    await socket.accept()
    try:
        session = relightings.session(number)
    except NotFoundError as error:
        await socket.close(NO_RELIGHTING, str(error))
        return
    outbox = _Outbox()
    session.listen(outbox.put)
    sending = asyncio.create_task(_send(socket, session, outbox))
    try:
        while (message := await socket.receive())["type"] == "websocket.receive":
            _hear(message.get("text") or "", session, outbox)
    finally:
        session.leave(outbox.put)
        sending.cancel()
        # Of a client that went away in the middle of a message nothing is left to be said.
        with suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
            await sending


def _hear(text: str, session: RelightingSession, outbox: "_Outbox") -> None:
    try:
        session.tell(read_change(text))
    except (ConfigError, NotFoundError) as error:
        outbox.put(Told({"kind": "problem", **problem_told(error)}))


async def _send(socket: WebSocket, session: RelightingSession, outbox: "_Outbox") -> None:
    """Send what there is; close after the end."""
    await socket.send_json({"kind": "hello", **session.describe()})
    while True:
        for told in await outbox.take():
            await socket.send_json(told.message)
            if told.picture is not None:
                await socket.send_bytes(told.picture)
            if told.message["kind"] == "end":
                await socket.close()
                return


class _Outbox:
    """What is to be sent to one client; of pictures that a slow one has not taken yet, the newest."""

    def __init__(self) -> None:
        self._loop, self._told, self._news = asyncio.get_running_loop(), list[Told](), asyncio.Event()

    def put(self, told: Told) -> None:
        """From any thread."""
        with suppress(RuntimeError):  # the loop is closed: nobody listens any more
            self._loop.call_soon_threadsafe(self._add, told)

    async def take(self) -> list[Told]:
        """All that came since the last time, once something has."""
        await self._news.wait()
        self._news.clear()
        told, self._told = self._told, []
        return told

    def _add(self, told: Told) -> None:
        if told.picture is not None:
            self._told = [each for each in self._told if each.picture is None]
        self._told.append(told)
        self._news.set()
