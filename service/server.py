"""The service on the loopback address."""

import os
import socket
from contextlib import suppress
from pathlib import Path

import uvicorn

from rig.config import RigConfig
from rig.errors import BusyError
from service.app import create_app
from service.capture import terminate_as_interrupt
from service.console import tell

HOST = "127.0.0.1"


def serve(config: RigConfig, sessions: Path, scenes: Path, port: int) -> None:
    """Serve until Ctrl-C or SIGTERM; sessions that run are stopped safely first. Raises BusyError for a taken port."""
    app = create_app(config, sessions, scenes)
    with _listener(port) as listener:
        tell(f"Start page: http://{HOST}:{port}/   REST: http://{HOST}:{port}/api/v1/docs   Ctrl-C ends.")
        server = uvicorn.Server(uvicorn.Config(app, log_level="warning"))
        try:
            # uvicorn ends itself, then passes the signal on.
            with terminate_as_interrupt(), suppress(KeyboardInterrupt):
                server.run(sockets=[listener])
        finally:
            app.state.host.close()  # which uvicorn leaves out after a second Ctrl-C


def _listener(port: int) -> socket.socket:
    try:
        return socket.create_server((HOST, port))
    except OSError as error:
        raise BusyError(f"{HOST}:{port}: {os.strerror(error.errno or 0)}. Name another port with --port.") from error
