"""Rectification of a mosaic to texels: error over that of a plain mean, variance and run time, with OpenCV as the peer.

A waved texture under shot noise, 1024x768, at 60 degrees elevation; 64 texels (nine pixels each way) and 256 (two).
Errors are over the noise of the mean of the pixels of one colour that a texel's own area holds. Every interpolation
borrows from pixels around it and may go below 1 where the texture is smooth; it loses where the texture is not.
"""

import numpy as np

from processing import geometry
from processing.cameras.calibration import CameraModel
from processing.cameras.lens import Pinhole
from processing.cameras.rectification import Texels, rectify
from processing.radiometry.hdr import Radiance
from service.bench import Result
from tests.benchmarks.yardsticks.bandwidth import fastest
from tests.benchmarks.yardsticks.rectify_peers import PEERS
from tests.reference.plane_scene import DISTORTION, RGGB, camera_at, mosaic_of, photograph, waves

SIZE, SIDE_M = (768, 1024), 0.060
LEVEL_E = 1000.0  # electrons where the texture is 1; it runs from 1 to 3


def run(*, quick: bool) -> Result:
    """Measure both sizes of texel; quick with fewer noise images."""
    clean, camera = scene()
    figures, rows = {}, []
    for count in (64, 256):
        found, measured = compare(clean, camera, Texels(count, SIDE_M), 2 if quick else 20)
        figures |= {f"{name}_{count}": value for name, value in found.items()}
        rows += measured
    return Result(figures, rows)


def scene():
    """The mosaic without noise, and its camera."""
    pose = camera_at(60).rig_from_camera
    camera = CameraModel(Pinhole(np.array([[10000.0, 0, 515], [0, 10010, 380], [0, 0, 1]]), DISTORTION), pose, SIZE)
    return mosaic_of(photograph(camera, np.eye(4), waves)), camera


def compare(clean, camera, texels, repeats):
    """Figures and rows of all methods over that many noise images."""
    truth, plain = _truth(texels), _plain_noise(camera, texels)
    methods = {"ours": lambda image: _ours(image, camera, texels)}
    methods |= {p.name: (lambda image, p=p: (p.rectify(image.value, camera, texels), None)) for p in PEERS}
    squares, predicted = dict.fromkeys(methods, 0.0), 0.0
    rng = np.random.default_rng(5)
    for _ in range(repeats):
        image = _noisy(clean, rng)
        for name, method in methods.items():
            value, variance = method(image)
            squares[name] += np.mean(((value - truth) / plain) ** 2) / repeats
            if variance is not None:
                predicted += np.mean(variance / plain**2) / repeats
    seconds = {name: fastest(lambda method=method: method(image), 3) for name, method in methods.items()}
    rows = [
        {"method": name, "size": f"{texels.count}x{texels.count}", "seconds": seconds[name],
         "error": float(squares[name] ** 0.5), "peer": name != "ours"}
        for name in methods
    ]  # fmt: skip
    figures = {
        "rectified_rmse_over_plain_mean": float(squares["ours"] ** 0.5),
        "rectified_variance_ratio": float(predicted / squares["ours"]),
        "ns_per_texel": seconds["ours"] / texels.count**2 * 1e9,
    }
    figures |= {f"peer_rectified_rmse_over_plain_mean_{p.name}": float(squares[p.name] ** 0.5) for p in PEERS}
    return figures, rows


def _ours(image, camera, texels):
    found = rectify(image, camera, np.eye(4), texels, RGGB)
    return found.value, found.variance


def _noisy(clean, rng):
    electrons = rng.poisson(clean.value * LEVEL_E)
    variance = clean.value / np.float32(LEVEL_E)
    return Radiance((electrons / LEVEL_E).astype(np.float32), variance, clean.status)


def _truth(texels):
    """Means over the texels, from eight points each way."""
    fine = waves(geometry.texel_grid(8 * texels.count, texels.side_m))
    return fine.reshape(texels.count, 8, texels.count, 8, 3).mean(axis=(1, 3))


def _plain_noise(camera, texels):
    """Deviation (n, n, 3) of the mean of a texel's own pixels of one colour."""
    corners = camera.project(geometry.texel_corners(texels.count, texels.side_m))
    one, other = corners[1:, 1:] - corners[:-1, :-1], corners[1:, :-1] - corners[:-1, 1:]
    area_px = np.abs(one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]) / 2
    pixels = area_px[..., None] * [0.25, 0.5, 0.25]
    return np.sqrt(_truth(texels) / LEVEL_E / pixels)
