"""Who may talk to the service: programs and pages of this machine, in requests of a sane size.

A page of another site runs in the operator's browser and could reach the loopback address: by a name that was pointed
at it (refused by `Host`), or by sending what needs no answer, such as a POST without a body or a WebSocket (refused by
`Origin`, which browsers send with both).
"""

from urllib.parse import urlsplit

from fastapi.responses import JSONResponse
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.problem_json import CONTENT_TOO_LARGE, problem_response

LOCAL_NAMES = ("127.0.0.1", "localhost", "::1")
MOST_BYTES = 1_000_000  # of a body; a plan of ten thousand angles has a tenth of that
_TOO_LARGE = f"a request has at most {MOST_BYTES} bytes."


class Guard:
    """ASGI middleware that refuses what no own page or program would send."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer what is refused; pass on what is not."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        refusal = _refusal(Headers(scope=scope))
        if refusal is None:
            await self._app(scope, _limited(receive) if scope["type"] == "http" else receive, send)
        else:
            await refusal(scope, receive, send)


def _refusal(headers: Headers) -> JSONResponse | None:
    host, origin = headers.get("host", ""), headers.get("origin")
    if urlsplit(f"//{host}").hostname not in LOCAL_NAMES:
        return problem_response(400, "bad-request", f"host {host!r} is not this machine: {', '.join(LOCAL_NAMES)}.")
    if origin is not None and urlsplit(origin).netloc != host:
        return problem_response(403, "forbidden", f"a page of {origin} may not talk to the rig.")
    length = headers.get("content-length", "")
    if length.isdecimal() and int(length) > MOST_BYTES:
        return problem_response(CONTENT_TOO_LARGE, "content-too-large", _TOO_LARGE)
    return None


def _limited(receive: Receive) -> Receive:
    """The same body; one that did not tell its length is counted as it comes."""
    received = 0

    async def limited() -> Message:
        nonlocal received
        message = await receive()
        received += len(message.get("body", b""))
        if received > MOST_BYTES:
            raise HTTPException(CONTENT_TOO_LARGE, _TOO_LARGE)
        return message

    return limited
