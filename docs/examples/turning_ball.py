"""Write a made-up turntable scan into a folder: 70 pictures of a striped ball under a red laser line, and scan.toml.

The ball has a radius of 30 mm; its centre is 10 mm beside the turntable's axis.
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

FOCAL_PX, WIDTH, HEIGHT = 700.0, 240, 200
AXIS_MM, RADIUS_MM, STEP_DEG, FRAMES = np.array([0.0, 0.0, 400.0]), 30.0, 6.0, 70
NORMAL = np.array([np.cos(0.5), 0.0, np.sin(0.5)])  # of the laser's plane, which holds the axis


def picture(number: int) -> Image.Image:
    """The ball as the camera sees it, the axis upright behind the middle of the picture."""
    row, column = np.mgrid[:HEIGHT, :WIDTH]
    ray = np.stack([(column - WIDTH / 2) / FOCAL_PX, (row - HEIGHT / 2) / FOCAL_PX, np.ones((HEIGHT, WIDTH))], axis=-1)
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    turned = np.radians(STEP_DEG * number)
    centre = AXIS_MM + 10.0 * np.array([np.sin(turned), 0.0, -np.cos(turned)])
    along = ray @ centre
    root = along**2 - centre @ centre + RADIUS_MM**2
    point = (along - np.sqrt(np.maximum(root, 0.0)))[..., None] * ray
    local = point - centre
    azimuth = np.arctan2(local[..., 0], -local[..., 2]) - turned
    paint = np.where(root > 0.0, 0.6 + 0.2 * np.sin(12.0 * azimuth) * np.sin(local[..., 1] / 2.0), 0.0)
    laser = 150.0 * np.exp(-0.5 * ((point - AXIS_MM) @ NORMAL / 0.8) ** 2)
    image = np.stack([paint * (60.0 + laser), paint * 60.0, paint * 60.0], axis=-1)
    noise = np.random.default_rng(number).normal(0.0, 1.0, image.shape)
    return Image.fromarray(np.clip(np.rint(image + noise), 0, 255).astype(np.uint8))


def main(folder: Path) -> None:
    """Write the pictures and their description."""
    (folder / "frames").mkdir(parents=True, exist_ok=True)
    for number in range(FRAMES):
        picture(number).save(folder / "frames" / f"frame{number}.png")
    (folder / "scan.toml").write_text(f"""images = "frames"
laser = "red"

[camera]
matrix = [[{FOCAL_PX}, 0, {WIDTH / 2}], [0, {FOCAL_PX}, {HEIGHT / 2}], [0, 0, 1]]

[laser_plane]
normal = {NORMAL.tolist()}
offset_mm = {float(NORMAL @ AXIS_MM)}

[turntable]
axis_point_mm = {AXIS_MM.tolist()}
axis_direction = [0, -1, 0]
step_deg = {STEP_DEG}
""")


main(Path(sys.argv[1]))
