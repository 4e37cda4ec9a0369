"""The start page in a real browser."""

import shutil
import subprocess
import threading
import time

import httpx2
import pytest
import uvicorn

from rig.config import load_config
from service.app import create_app
from tests.service.conftest import API, CALIBRATE

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
OPTIONS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --virtual-time-budget=8000 --dump-dom"
).split()


@pytest.fixture
def address(simulated_rig, tmp_path):
    """The application behind a real socket."""
    app = create_app(load_config(simulated_rig.toml), tmp_path / "sessions")
    server = uvicorn.Server(uvicorn.Config(app, host="127.0.0.1", port=0, log_level="error"))
    thread = threading.Thread(target=server.run)
    thread.start()
    while not server.started:
        time.sleep(0.01)
    port = server.servers[0].sockets[0].getsockname()[1]
    yield f"http://127.0.0.1:{port}"
    server.should_exit = True
    thread.join()


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: apt-get install chromium")
def test_the_page_shows_a_session_and_its_events(address, tmp_path):
    with httpx2.Client(base_url=address, timeout=30) as client:
        session = client.post(f"{API}/sessions", json=CALIBRATE).json()["id"]
        while client.get(f"{API}/sessions/{session}").json()["state"] != "finished":
            time.sleep(0.1)
    command = [CHROMIUM, *OPTIONS, f"--user-data-dir={tmp_path / 'browser'}", f"{address}/"]
    page = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout
    assert f">{session}<" in page
    assert "finished: 8 of 8 steps" in page
    log = page.split('id="log"', 1)[1].split("</div>", 1)[0]
    assert "done" in log  # came over the WebSocket
