"""A scene so coarse that it is precomputed in a moment."""

from pathlib import Path

import numpy as np

from processing.formats.radiance_hdr import write_hdr

COARSE = """
environment = "day.hdr"
environments = ["night.hdr"]

[camera]
azimuth_deg = -50
elevation_deg = 30

[precomputation]
directions = 1024
resolution = 6

[materials.red]
kind = "lambert"
albedo = [0.7, 0.1, 0.05]

[materials.lacquer]
kind = "ggx"
diffuse = [0.1, 0.2, 0.5]
normal_reflectance = [0.05, 0.05, 0.05]
roughness = 0.3

[[body]]
name = "floor"
mesh = "plane"
scale = 0.5
edge_mm = 60

[[body]]
name = "box"
mesh = "box"
scale = [0.2, 0.15, 0.3]
place_mm = [0, 0, 151]
turn_deg = 20
edge_mm = 60
material = "red"

[[body]]
name = "brick"
mesh = "box"
scale = 0.1
place_mm = [-200, -150, 51]
edge_mm = 50
material = "lacquer"
"""


def write_scene(folder: Path, text: str = COARSE, name: str = "coarse.toml") -> Path:
    """The scene file with its two environments, in a folder that is made."""
    folder.mkdir(parents=True, exist_ok=True)
    height = 16
    row = (np.arange(height) + 0.5)[:, None] / height
    column = (np.arange(2 * height) + 0.5) / height - 1
    sky = np.where(row < 0.5, 0.4, 0.05)
    window = 8.0 * ((np.abs(column - 0.3) < 0.2) & (np.abs(row - 0.3) < 0.1))
    lamp = 30.0 * ((np.abs(column + 0.6) < 0.1) & (np.abs(row - 0.2) < 0.08))
    write_hdr(folder / "day.hdr", ((sky + window)[..., None] * [1.0, 1.05, 1.1]).astype(np.float32))
    write_hdr(folder / "night.hdr", ((0.05 * sky + lamp)[..., None] * [1.0, 0.7, 0.4]).astype(np.float32))
    path = folder / name
    path.write_text(text)
    return path
