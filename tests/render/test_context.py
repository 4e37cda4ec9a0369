"""Where no OpenGL can be had: one clear message, and the NumPy reference draws."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

PROGRAM = """
import logging, sys
logging.basicConfig(format="%(levelname)s %(message)s", stream=sys.stderr)
from render.context import open_context
from render.errors import GlUnavailableError
from render.preview import Preview
from render.scene import Scene, framed, light
from render.shapes import plane
from tests.render.synthetic import pattern

try:
    open_context()
    raise SystemExit("a context without its library")
except GlUnavailableError as error:
    print(error)
mesh = plane()
scene = Scene.of(mesh, pattern(8), framed(mesh, (32, 32), azimuth_rad=0.3, elevation_rad=0.8), (light(0.0, 1.0),))
with Preview((24, 16)) as preview:
    picture = preview.draw(scene)
    print(preview.renderer_name, picture.radiance.shape, bool(picture.mask.any()), float(picture.radiance.max()) > 0.05)
"""


@pytest.mark.parametrize(
    "without",
    [{"GLCONTEXT_LINUX_LIBEGL": "libEGL_that_is_not_there.so"}, {"__EGL_VENDOR_LIBRARY_FILENAMES": "/nowhere.json"}],
    ids=["no libEGL", "no driver"],
)
def test_without_opengl_the_reference_draws_after_one_notice(without):
    result = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        cwd=ROOT,
        env=os.environ | without,
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert result.returncode == 0, result.stderr
    message, drawn = result.stdout.splitlines()
    assert "no OpenGL 3.3 context over EGL" in message
    assert "install libegl1" in message
    assert drawn == "NumPy reference (16, 24, 3) True True"
    notices = [line for line in result.stderr.splitlines() if "NumPy reference draws instead" in line]
    assert len(notices) == 1
    assert notices[0].startswith("WARNING no OpenGL")


def test_renderer_says_which_library_draws(gl):
    assert gl.name
    assert gl.name != "NumPy reference"
