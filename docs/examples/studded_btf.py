"""Make photographs of a studded tile from 13 directions under 13 lights each, named as the BTFs of UBO2003 are."""

import sys
from itertools import product
from pathlib import Path

import numpy as np
from PIL import Image

SIZE, DEPTH = 24, 4.0  # texels
RINGS = ((0, 1), (30, 4), (60, 8))  # polar angle in degrees, directions at that angle
STEP = 0.02  # texels that a ray falls or rises at a time


def direction(polar_deg: float, azimuth_deg: float) -> np.ndarray:
    """Unit vector away from the tile; x to the right in the pictures, y up."""
    polar, azimuth = np.radians([polar_deg, azimuth_deg])
    return np.array([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])


def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Round studs, four on the tile, whose tops lie DEPTH / 2 over the plane z = 0 and whose feet as far under it."""
    half = SIZE / 2
    apart = np.hypot((x + half / 2) % half - half / 2, (y + half / 2) % half - half / 2)
    return DEPTH * (1 / (1 + np.exp(2 * (apart - 3.5))) - 0.5)


def seen_from(view: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Where the rays through `places` (n, 3) of the plane z = 0 first meet the surface (n, 3)."""
    ways = view / view[2]
    found, going = places + DEPTH / 2 * ways, np.ones(len(places), bool)
    while going.any():
        going &= found[:, 2] > height(found[:, 0], found[:, 1])
        found[going] -= STEP * ways
    return found


def lit(points: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Whether nothing stands between points (n, 3) and the light (n,)."""
    ways, free = light / light[2], np.ones(len(points), bool)
    for step in np.arange(0.2, DEPTH, 5 * STEP):
        on = points + step * ways
        free &= on[:, 2] > height(on[:, 0], on[:, 1])
    return free


def picture(points: np.ndarray, light: np.ndarray, view: np.ndarray) -> np.ndarray:
    """Linear values (n, 3): a matt ground colour that varies from place to place, and a broad highlight."""
    x, y, small = points[:, 0], points[:, 1], 1e-3
    slopes = [(height(x + small, y) - height(x, y)) / small, (height(x, y + small) - height(x, y)) / small]
    normal = np.stack([-slopes[0], -slopes[1], np.ones_like(x)], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    half = (light + view) / np.linalg.norm(light + view)
    turn = 2 * np.pi / SIZE
    grain = 0.7 + 0.3 * np.sin(2 * turn * x + 1) * np.sin(5 * turn * y) + 0.2 * np.sin(turn * (7 * x - 3 * y))
    colour = np.clip(grain, 0, None)[:, None] * np.array([0.6, 0.45, 0.3])
    gloss = 0.3 * np.maximum(normal @ half, 0) ** 20
    return (colour * np.maximum(normal @ light, 0)[:, None] + gloss[:, None]) * lit(points, light)[:, None]


def main(folder: Path) -> None:
    """Write 169 JPEG files into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    middle = np.arange(SIZE) + 0.5
    x, y = np.meshgrid(middle, SIZE - middle)
    places = np.stack([x.ravel(), y.ravel(), np.zeros(SIZE * SIZE)], axis=1)
    angles = [(polar, 360 * k // count) for polar, count in RINGS for k in range(count)]
    points = {angle: seen_from(direction(*angle), places) for angle in angles}
    for number, (light, view) in enumerate(product(angles, angles)):
        seen = picture(points[view], direction(*light), direction(*view)).reshape(SIZE, SIZE, 3)
        name = f"{number:05d} tl{light[0]:03d} pl{light[1]:03d} tv{view[0]:03d} pv{view[1]:03d}.jpg"
        Image.fromarray(np.uint8(255 * np.clip(seen, 0, 1))).save(folder / name, quality=98, subsampling=0)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
