"""The start page in a real browser, driven over the browser's own debugging protocol."""

import json
import shutil
import subprocess
import threading
import time
from contextlib import contextmanager
from itertools import count

import httpx2
import pytest
import uvicorn
from websockets.sync.client import connect

from rig.config import load_config
from service.app import create_app
from tests.service.conftest import API, CALIBRATE, SMALL_BTF

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
OPTIONS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --remote-debugging-port=0"
).split()
WAIT_S = 30.0

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: apt-get install chromium")


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


class Page:
    """One tab of the browser."""

    def __init__(self, socket) -> None:
        self._socket, self._numbers = socket, count(1)

    def command(self, method, **parameters):
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while (message := json.loads(self._socket.recv(WAIT_S))).get("id") != number:
            pass
        assert "error" not in message, message
        return message["result"]

    def _told(self, expression):
        return self.command("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)

    def evaluate(self, expression):
        told = self._told(expression)
        assert "exceptionDetails" not in told, told
        return told["result"].get("value")

    def wait(self, expression):
        """The expression's value once it is true; a page that is still loading may not have what it names."""
        deadline_s = time.monotonic() + WAIT_S
        while "exceptionDetails" in (told := self._told(expression)) or not (value := told["result"].get("value")):
            shown = self._told("document.body.innerText")["result"].get("value")
            assert time.monotonic() < deadline_s, f"{expression} never came true; the page shows:\n{shown}"
            time.sleep(0.05)
        return value

    def press(self, element, key="Enter"):
        """Put the focus on an element and press a key."""
        self.evaluate(f"document.querySelector({json.dumps(element)}).focus()")
        for kind in ("keyDown", "keyUp"):
            self.command("Input.dispatchKeyEvent", type=kind, key=key, text="\r", windowsVirtualKeyCode=13)

    def text(self, element):
        return self.evaluate(f"document.querySelector({json.dumps(element)}).textContent")


def _until(wanted):
    deadline_s = time.monotonic() + WAIT_S
    while not (found := wanted()):
        assert time.monotonic() < deadline_s
        time.sleep(0.02)
    return found


@contextmanager
def browser(address, folder):
    command = [CHROMIUM, *OPTIONS, f"--user-data-dir={folder}", "about:blank"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        marks = folder / "DevToolsActivePort"
        port = _until(lambda: marks.exists() and marks.read_text()).splitlines()[0]
        tabs = _until(lambda: httpx2.get(f"http://127.0.0.1:{port}/json/list").json())
        with connect(tabs[0]["webSocketDebuggerUrl"], max_size=None) as socket:
            page = Page(socket)
            page.command("Page.navigate", url=address)
            page.wait("document.readyState === 'complete' && location.protocol === 'http:'")
            yield page
    finally:
        process.kill()
        process.wait()


@pytest.fixture
def page(address, tmp_path):
    with browser(address, tmp_path / "browser") as page:
        yield page


def type_plan(page, plan):
    page.evaluate(f"document.querySelector('#plan').value = {json.dumps(json.dumps(plan))}")


def test_a_plan_is_started_by_keyboard_and_followed_to_its_end(page):
    type_plan(page, CALIBRATE)
    page.press("#check")
    assert "4 steps, 8 frames" in page.wait("document.querySelector('#answer').textContent")
    page.press("#go")
    page.wait("document.querySelector('#status').textContent.startsWith('finished: 4 of 4')")
    page.wait("document.querySelector('#log').textContent.includes('end')")
    assert page.text("#log").count("done") == 4  # came over the WebSocket, each once
    assert page.evaluate("document.querySelector('#bar').value / document.querySelector('#bar').max") == 1
    page.wait("document.querySelector('#frame').naturalWidth > 100")
    assert "cam" in page.evaluate("document.querySelector('#frame').alt")
    session = page.text("#session-id")
    assert page.evaluate("location.hash") == f"#{session}"
    assert session in page.text("#sessions")

    page.command("Page.reload")
    page.wait(f"document.querySelector('#log').textContent.includes('end') && shown === '{session}'")
    assert page.text("#log").count("done") == 4  # told again to who comes later


def test_stop_stops_what_runs_whichever_session_is_shown(page, address):
    page.press("#stop")
    page.wait("document.querySelector('#answer').textContent.startsWith('Nothing runs')")
    with httpx2.Client(base_url=f"{address}{API}", timeout=30) as client:
        session = client.post("/sessions", json=SMALL_BTF | {"turntable_deg": [0, 45, 90, 135, 180]}).json()["id"]
        page.evaluate("scrollTo(0, document.body.scrollHeight); follow('another')")
        on_top = "document.elementFromPoint(r.x + r.width / 2, r.y + r.height / 2).id"
        assert page.evaluate(f"{{ const r = at('stop').getBoundingClientRect(); {on_top} }}") == "stop"
        assert not page.evaluate("at('stop').disabled")
        page.press("#stop")
        page.wait(f"document.querySelector('#answer').textContent.startsWith('{session} stops')")
        _until(lambda: client.get(f"/sessions/{session}").json()["state"] == "interrupted")


def test_an_error_is_shown_in_its_own_words(page):
    type_plan(page, SMALL_BTF | {"lamps": ["sun"]})
    page.press("#go")
    page.wait("document.querySelector('#answer').className === 'problem'")
    assert page.text("#answer").startswith("unknown-device: ")
    assert "sun" in page.text("#answer")


NAMED = """
[...document.querySelectorAll("button, textarea, progress, a, [role=log]")].filter(one =>
  !(one.textContent.trim() || one.getAttribute("aria-label"))).length
"""
CONTRAST = """{
  const light = colour => { const [r, g, b] = colour.match(/[0-9.]+/g).slice(0, 3).map(v => v / 255)
    .map(v => v <= .04045 ? v / 12.92 : ((v + .055) / 1.055) ** 2.4); return .2126 * r + .7152 * g + .0722 * b; };
  const behind = one => { for (; one; one = one.parentElement) { const c = getComputedStyle(one).backgroundColor;
    if (!/, 0\\)$/.test(c)) return c; }
    return matchMedia("(prefers-color-scheme: dark)").matches ? "rgb(18, 18, 18)" : "rgb(255, 255, 255)"; };
  Math.min(...[...document.querySelectorAll("h1, p, th, .stop, .problem")].filter(one => one.textContent.trim())
    .map(one => [light(getComputedStyle(one).color), light(behind(one))].sort((a, b) => b - a))
    .map(([high, low]) => (high + .05) / (low + .05)));
}"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_everything_has_a_name_and_can_be_read_in_light_and_dark(page, scheme):
    """Contrast of text of at least 4.5 (WCAG 2.2, 1.4.3), also of an error."""
    page.command("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
    page.evaluate("report('an error', true)")
    assert page.evaluate(f"matchMedia('(prefers-color-scheme: {scheme})').matches")
    assert page.evaluate(NAMED) == 0
    assert page.evaluate(CONTRAST) >= 4.5
