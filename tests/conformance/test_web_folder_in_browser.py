"""A web folder in a browser: its own JPEG decoder, and the published sum in the page's script."""

import json
import re
import shutil
import subprocess

import numpy as np
import pytest

from processing.formats.relight import write_relight
from processing.materials.ptm import fit_ptm
from tests.reference.ptm import board, dome

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
OPTIONS = "--headless --no-sandbox --disable-gpu --no-first-run --disable-background-networking --dump-dom".split()
PAGE = """<!DOCTYPE html><body>%s<pre id="seen"></pre><script>
const info = %s, weights = %s, material = info.materials[0];
onload = () => {
  const picture = new Array(3 * info.width * info.height).fill(0);
  document.querySelectorAll('img').forEach((plane, term) => {
    const canvas = document.createElement('canvas');
    canvas.width = info.width; canvas.height = info.height;
    const context = canvas.getContext('2d');
    context.drawImage(plane, 0, 0);
    const bytes = context.getImageData(0, 0, info.width, info.height).data;
    for (let i = 0; i < picture.length; i++) {
      const channel = i %% 3, n = 3 * term + channel;
      const byte = bytes[4 * Math.floor(i / 3) + channel];
      picture[i] += weights[term] * (byte / 255 - material.bias[n]) * material.scale[n];
    }
  });
  document.getElementById('seen').textContent = JSON.stringify(picture.map(value => Math.round(1000 * value)));
};
</script></body>"""

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: apt-get install chromium")


def test_a_browser_shows_the_picture(tmp_path):
    lights = dome(32)
    image = fit_ptm(board(lights, (24, 40), seed=6), lights).image
    folder = tmp_path / "web"
    write_relight(folder, image)
    info = json.loads((folder / "info.json").read_text())
    x, y, z = lights[20]
    planes = "".join(f'<img src="plane_{number}.jpg">' for number in range(info["nplanes"] // 3))
    page = PAGE % (planes, json.dumps(info), json.dumps([1, x, y, x * x, x * y, y * y]))
    (folder / "page.html").write_text(page)
    command = [CHROMIUM, *OPTIONS, "--allow-file-access-from-files", f"--user-data-dir={tmp_path / 'profile'}"]
    done = subprocess.run(
        [*command, (folder / "page.html").as_uri()], capture_output=True, text=True, timeout=60, check=True
    )
    found = re.search(r'<pre id="seen">(\[.*?\])</pre>', done.stdout)
    assert found, done.stdout[-500:]
    seen = np.array(json.loads(found[1])).reshape(24, 40, 3) / 1000
    off = 255 * (seen - image.evaluate(np.array([x, y, z])))
    assert np.sqrt(np.mean(off**2)) < 6  # JPEG; single pixels are noise to it
    mirrored = [seen[::-1], seen[:, ::-1], seen[..., ::-1]]
    assert (
        min(255 * np.sqrt(np.mean((other - seen) ** 2)) for other in mirrored) > 15
    )  # so that a turned one would fail
