"""The start page's part about light, in a real browser."""

import base64
import io
import json
import threading
import time

import numpy as np
import pytest
import uvicorn
from PIL import Image
from typer.testing import CliRunner

from rig.config import load_config
from service.app import create_app
from service.cli import app as cli
from service.relit_scene import Orbit
from service.relit_session import SETTLED_S
from tests.service.relit_scenes import write_scene
from tests.service.test_page import CHROMIUM, CONTRAST, browser

SHIFT = 8
UNNAMED = """
[...document.querySelectorAll("button, select, input, canvas, progress, output")].filter(one =>
  !(one.textContent.trim() || one.getAttribute("aria-label") || one.closest("label"))).map(one => one.id)
"""

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: apt-get install chromium")


@pytest.fixture(scope="module")
def address(shared_simulated_rig, tmp_path_factory):
    """The application behind a real socket, with one scene, which the command has drawn: kernels are compiled."""
    folder = tmp_path_factory.mktemp("light")
    told = CliRunner().invoke(cli, ["relight", str(write_scene(folder / "scenes")), "-o", str(folder / "own.png"),
                                    "--precomputed", str(folder / "sessions" / ".precomputed")])  # fmt: skip
    assert told.exit_code == 0, told.output
    app = create_app(load_config(shared_simulated_rig.toml), folder / "sessions", folder / "scenes")
    server = uvicorn.Server(uvicorn.Config(app, host="127.0.0.1", port=0, log_level="error"))
    thread = threading.Thread(target=server.run)
    thread.start()
    while not server.started:
        time.sleep(0.01)
    yield f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}", folder
    server.should_exit = True
    thread.join()


class Studio:
    """The panel of the page with the scene open."""

    def __init__(self, page) -> None:
        self.page = page
        page.wait("at('subject').options.length > 0")
        page.evaluate("at('view').dataset.frames = 0; drawn = numbered = 0")
        page.press("#open-light")
        self.settled(0)
        page.evaluate("at('view').scrollIntoView({block: 'center'})")

    def settled(self, after):
        """Until a full picture has come since the one of a number, and none after it."""
        number = "Number(at('view').dataset.frames)"
        while True:
            self.page.wait(f"{number} > {after} && at('view').dataset.rough === 'false'")
            after = self.page.evaluate(number)
            time.sleep(2 * SETTLED_S)
            if self.page.evaluate(number) == after:
                return
            after -= 1

    def after(self, act):
        """The picture once what is done has been shown."""
        frames = self.page.evaluate("Number(at('view').dataset.frames)")
        act()
        self.settled(frames)
        return self.picture()

    def picture(self):
        data = self.page.evaluate("at('view').toDataURL('image/png')").split(",")[1]
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB")).astype(int)

    def standing(self):
        return json.loads(self.page.evaluate("JSON.stringify(scenery)"))

    def drag(self, start, by, modifiers=0):
        """In pixels of the picture as it is shown, from a place in it."""
        x, y, width, _ = self.box()
        shown = width / 720
        for kind, share, buttons in (("mousePressed", 0, 1), *(("mouseMoved", k / 4, 1) for k in (1, 2, 3, 4)),
                                     ("mouseReleased", 1, 0)):  # fmt: skip
            self.page.command(
                "Input.dispatchMouseEvent", type=kind, x=x + shown * (start[0] + share * by[0]),
                y=y + shown * (start[1] + share * by[1]), button="left", buttons=buttons, clickCount=1,
                modifiers=modifiers,
            )  # fmt: skip

    def box(self):
        return self.page.evaluate("(r => [r.x, r.y, r.width, r.height])(at('view').getBoundingClientRect())")

    def choose(self, element, value):
        self.page.evaluate(
            f"at('{element}').value = {json.dumps(value)}; at('{element}').dispatchEvent(new Event('change'))"
        )


@pytest.fixture(scope="module")
def page(address):
    with browser(address[0], address[1] / "browser") as page:
        yield page


@pytest.fixture
def studio(page):
    yield Studio(page)
    page.press("#close-light")
    page.wait("at('light-status').textContent === 'Nothing is open.'")


def differs(one, two):
    return (np.abs(one - two).max(axis=2) > 8).mean()


def seen_at(standing, body):
    """Where in the picture the place of a body is."""
    eye = standing["eye"]
    angles = np.radians([eye["azimuth_deg"], eye["elevation_deg"], eye["field_of_view_deg"]])
    target_m = tuple(value / 1e3 for value in eye["target_mm"])
    camera = Orbit(target_m, *angles[:2], eye["distance_mm"] / 1e3, angles[2]).camera((720, 480))
    u, v, depth = camera.projected(np.array([standing["bodies"][body]["place_mm"]]) / 1e3)[0]
    return np.array([u / depth, v / depth])


def test_the_picture_is_the_commands_and_follows_the_hand(studio, address):
    first = studio.picture()
    assert np.array_equal(first, np.asarray(Image.open(address[1] / "own.png")))

    before = studio.standing()["eye"]
    turned = studio.after(lambda: studio.drag((360, 240), (-100, 40)))
    after, shown = studio.standing()["eye"], studio.box()[2] / 720
    assert after["azimuth_deg"] - before["azimuth_deg"] == pytest.approx(40 * shown, rel=0.02)
    assert after["elevation_deg"] - before["elevation_deg"] == pytest.approx(12 * shown, rel=0.02)
    assert differs(first, turned) > 0.05
    assert studio.page.text("#frame-told").startswith("0 vertices lit anew")

    studio.choose("body", "brick")
    start = seen_at(studio.standing(), "brick")
    moved = studio.after(lambda: studio.drag(start, (130, -30), SHIFT))
    place = seen_at(studio.standing(), "brick")
    assert place - start == pytest.approx([130, -30], abs=2.0)  # it stays under the hand
    assert studio.standing()["bodies"]["brick"]["place_mm"][2] == pytest.approx(51)
    assert differs(turned, moved) > 0.002


def test_controls_and_keys_change_light_and_materials(studio):
    page = studio.page
    pictures = [studio.picture()]

    def slide(element, value):
        page.evaluate(f"at('{element}').value = {value}; at('{element}').dispatchEvent(new Event('input'))")
        page.evaluate(f"at('{element}').dispatchEvent(new Event('change'))")

    def press(key, modifiers=0):
        page.evaluate("at('view').focus()")
        for kind in ("rawKeyDown", "keyUp"):
            page.command("Input.dispatchKeyEvent", type=kind, key=key, modifiers=modifiers)

    for act in (
        lambda: slide("light-turn", 100),
        lambda: studio.choose("environment", "night"),
        lambda: studio.choose("body", "box") or studio.choose("material", "from the shelf: gold"),
        lambda: slide("body-turn", 80),
        lambda: press("ArrowLeft"),
        lambda: press("+"),
        lambda: press("ArrowUp", SHIFT),
    ):
        pictures.append(studio.after(act))
        assert differs(*pictures[-2:]) > 0.001
    told = studio.standing()
    assert (told["light_azimuth_deg"], told["environment"]) == (pytest.approx(100), "night")
    assert told["bodies"]["box"]["material"] == "from the shelf: gold"
    assert told["bodies"]["box"]["turn_deg"] == pytest.approx([0, 0, 80])

    page.command("Page.reload")  # and it goes on as it stood
    page.wait("at('view').dataset.rough === 'false' && at('environment').value === 'night'")
    assert np.array_equal(studio.picture(), pictures[-1])
    assert page.evaluate("at('light-angle').textContent") == "100°"


def test_everything_has_a_name_and_problems_are_shown(studio):
    page = studio.page
    assert page.evaluate(UNNAMED) == []
    for scheme in ("light", "dark"):
        page.command("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        assert page.evaluate(CONTRAST) >= 4.5
    page.evaluate("tellLight({kind: 'environment', name: 'noon'})")
    page.wait("at('light-status').className === 'problem'")
    assert page.text("#light-status").startswith("not-found: no environment 'noon'")
    studio.after(lambda: studio.choose("environment", "night"))
