"""The service on the loopback address."""

from pathlib import Path

import uvicorn

from rig.config import RigConfig
from service.app import create_app
from service.console import tell


def serve(config: RigConfig, sessions: Path, port: int) -> None:
    """Serve until Ctrl-C; sessions that run are stopped safely first."""
    tell(f"Start page: http://127.0.0.1:{port}/   REST: http://127.0.0.1:{port}/api/v1/docs   Ctrl-C ends.")
    uvicorn.run(create_app(config, sessions), host="127.0.0.1", port=port, log_level="warning")
