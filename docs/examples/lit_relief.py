"""Make photographs of a relief under lights from all sides, and the .lp that says where these were."""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

SIZE, LIGHTS = 120, 24


def main(folder: Path) -> None:
    """Write 24 JPEG files and lights.lp into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    y, x = np.mgrid[1 : -1 : SIZE * 1j, -1 : 1 : SIZE * 1j]  # y is up
    height = 0.12 * np.cos(9 * np.hypot(x, y)) * np.exp(-2 * (x**2 + y**2))
    down, right = np.gradient(height, 2 / (SIZE - 1))
    normal = np.stack([-right, down, np.ones_like(height)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    colour = np.array([0.7, 0.5, 0.3]) * (0.8 + 0.2 * np.sign(np.sin(12 * x) * np.sin(12 * y)))[..., None]
    lines = [str(LIGHTS)]
    for number in range(LIGHTS):
        z, azimuth = 0.25 + 0.7 * (number + 0.5) / LIGHTS, 2.4 * number
        light = np.array([np.sqrt(1 - z * z) * np.cos(azimuth), np.sqrt(1 - z * z) * np.sin(azimuth), z])
        seen = colour * np.maximum(normal @ light, 0)[..., None]
        Image.fromarray(np.uint8(255 * seen ** (1 / 2.2))).save(folder / f"{number:02d}.jpg", quality=95)
        lines.append(f"{number:02d}.jpg {light[0]:.5f} {light[1]:.5f} {light[2]:.5f}")
    (folder / "lights.lp").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
