"""OpenCV's way from a mosaic to texels: demosaic to 16 bit, then look the texels up in the colour image."""

from dataclasses import dataclass

import cv2
import numpy as np

from processing import geometry

OPENING_PX = 600  # about the side of the texels' square in the image
SCALE = 12000.0  # counts per unit of the texture, which is at most 3.4 with its noise


@dataclass(frozen=True)
class Peer:
    """One set-up: how it demosaics, and whether it averages points a pixel apart over each texel."""

    name: str
    code: int
    averaging: bool

    def rectify(self, mosaic, camera, texels):
        """Texels (n, n, 3), red first."""
        counts = np.clip(mosaic * SCALE + 0.5, 0, 65535).astype(np.uint16)
        colour = cv2.demosaicing(counts, self.code).astype(np.float32)[..., ::-1]
        fine = -(-OPENING_PX // texels.count) if self.averaging else 1
        points = geometry.texel_grid(fine * texels.count, texels.side_m)
        uv_px = camera.project(points).astype(np.float32)
        looked_up = cv2.remap(np.ascontiguousarray(colour), uv_px, None, cv2.INTER_LINEAR)
        if fine > 1:
            looked_up = cv2.resize(looked_up, (texels.count, texels.count), interpolation=cv2.INTER_AREA)
        return looked_up / SCALE


PEERS = (
    Peer("opencv_bilinear_points", cv2.COLOR_BayerBG2BGR, averaging=False),
    Peer("opencv_bilinear_area", cv2.COLOR_BayerBG2BGR, averaging=True),
    Peer("opencv_edge_aware_area", cv2.COLOR_BayerBG2BGR_EA, averaging=True),
)
