"""Other packages' merges of a mosaic stack in memory, each in the best set-up that it offers, and textbook references.

Every merge takes counts (k, h, w) from the shortest exposure to the longest, with the sensor's true parameters, and
returns electrons per second (h, w). Packages that only know colour images get three rows of the mosaic as channels.
"""

import importlib
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from types import SimpleNamespace
from unittest.mock import patch

import cv2
import numpy as np

from tests.benchmarks.yardsticks.hdr_stack import EXPOSURE_S, SENSOR

SPAN_DN = SENSOR.white_dn - SENSOR.black_dn
FULL_E = SPAN_DN * SENSOR.gain_e_per_dn
_CODES_PER_DN = 65535 / SENSOR.white_dn  # OpenCV's weights end at code 65535


@dataclass(frozen=True)
class Peer:
    """One method: its `merge`, what was set for it, and the package or program that it needs."""

    name: str
    merge: Callable[[np.ndarray], np.ndarray]
    settings: str
    needs: str = "numpy"  # module or program
    reference: bool = False  # the textbook's formula in NumPy, no package

    def missing(self):
        """Why this peer cannot run here; empty where it can."""
        if importlib.util.find_spec(self.needs) is None and shutil.which(self.needs) is None:
            return f"{self.needs} is not installed"
        return ""

    def version(self):
        """Of the package that holds the module; empty for a program."""
        found = metadata.packages_distributions().get(self.needs, [""])[0]
        return f"{found} {metadata.version(found)}" if found else ""


def hdrutils(raw_dn):
    import HDRutils
    import HDRutils.io

    module = importlib.import_module("HDRutils.merge")
    height, width = raw_dn.shape[1:]
    metadata = {
        "N": len(raw_dn), "h": height, "w": width, "exp": EXPOSURE_S.copy(), "gain": np.ones(len(raw_dn)),
        "aperture": np.ones(len(raw_dn)), "black_level": np.full(4, SENSOR.black_dn), "raw_format": True,
        "saturation_point": 0.98 * SENSOR.white_dn, "color_space": "raw", "libraw_scale": lambda image: image,
    }  # fmt: skip
    quiet = SimpleNamespace(tqdm=lambda files, leave: files)
    import colour_demosaicing

    with (
        patch.object(module, "get_metadata", lambda *_, **__: metadata),
        patch.object(module, "tqdm", quiet),
        patch.object(HDRutils.io, "imread", lambda frame, libraw=True: frame),
        patch.object(colour_demosaicing, "demosaicing_CFA_Bayer_bilinear", lambda cfa, pattern: cfa.reshape(-1, 3)),
    ):
        merged, _ = module.merge(list(raw_dn), demosaic_first=False, color_space="raw")
    return merged.reshape(height, width) * SENSOR.gain_e_per_dn


def colour_hdri_debevec(raw_dn):
    from colour_hdri import weighting_function_Debevec1997

    return _colour_hdri(raw_dn, weighting_function_Debevec1997)


def colour_hdri_double_sigmoid(raw_dn):
    from colour_hdri import double_sigmoid_anchored_function

    return _colour_hdri(raw_dn, double_sigmoid_anchored_function)


def _colour_hdri(raw_dn, weighting):
    import colour
    from colour_hdri import Image, ImageStack, Metadata, image_stack_to_HDRI
    from colour_hdri.exposure import average_luminance

    stack = ImageStack()
    for frame, exposure_s in zip(raw_dn, EXPOSURE_S, strict=True):
        unit = (frame - SENSOR.black_dn) / SPAN_DN
        stack.append(Image(data=unit, metadata=Metadata(1.0, exposure_s, 100.0, None, None, None)))
    with colour.utilities.suppress_warnings(colour_warnings=True):
        merged = image_stack_to_HDRI(stack, weighting)
    return merged * FULL_E / average_luminance(1.0, 1.0, 100.0)


def opencv_debevec_u16(raw_dn):
    signal = np.maximum(raw_dn - SENSOR.black_dn, 0) / SPAN_DN
    return _opencv_debevec((signal * 65535 + 0.5).astype(np.uint16), 65535 / FULL_E)


def opencv_debevec_f32(raw_dn):
    signal = np.maximum(raw_dn.astype(np.float32) - SENSOR.black_dn, 0) / SPAN_DN
    return _opencv_debevec(signal.astype(np.float32), 65535 / FULL_E)


def _opencv_debevec(frames, codes_per_e):
    merged = cv2.createMergeDebevec().process(list(frames), EXPOSURE_S.astype(np.float32))
    return merged / codes_per_e


def opencv_robertson_u16(raw_dn):
    codes = (raw_dn * _CODES_PER_DN + 0.5).astype(np.uint16)
    return _opencv_robertson(codes)


def opencv_robertson_f32(raw_dn):
    return _opencv_robertson(raw_dn.astype(np.float32) / np.float32(SENSOR.white_dn))


def _opencv_robertson(frames):
    # The response is linear from the black level on, so that negative noise stays negative.
    response = np.arange(65536, dtype=np.float32) - np.float32(_CODES_PER_DN * SENSOR.black_dn)
    curve = np.repeat(response[:, None, None], 3, axis=2)
    images = [_as_colour(frame) for frame in frames]
    merged = cv2.createMergeRobertson().process(images, EXPOSURE_S.astype(np.float32), curve)
    return _as_mosaic(merged) * (SENSOR.gain_e_per_dn / _CODES_PER_DN)


def _as_colour(frame):
    return np.ascontiguousarray(np.moveaxis(frame.reshape(-1, 3, frame.shape[1]), 1, 2))


def _as_mosaic(colour):
    return np.moveaxis(colour, 2, 1).reshape(-1, colour.shape[1])


# ITU-R BT.709 primaries and D65, as pfstools turns its XYZ streams into RGB.
_XYZ_FROM_RGB = np.array(
    [[0.412424, 0.357579, 0.180464], [0.212656, 0.715158, 0.072186], [0.019332, 0.119193, 0.950444]]
)


def pfshdrcalibrate(raw_dn):
    electron = 65535 / FULL_E  # in its codes, as all noise parameters; the last one is the rounding
    noise = f"{electron:.12f},{electron:.12f},{electron:.12f},{SENSOR.read_noise_e},{SENSOR.gain_e_per_dn / 12**0.5}"
    command = ["pfshdrcalibrate", "-r", "linear", "-b", "16", "-o", "0.02", "-n", noise]
    stream = b"".join(_pfs_frame(*pair) for pair in zip(raw_dn, EXPOSURE_S, strict=True))
    output = subprocess.run(command, input=stream, capture_output=True, check=True).stdout
    height, width = raw_dn.shape[1:]
    planes = np.frombuffer(output[output.index(b"ENDH") + 4 :], np.float32).reshape(3, -1, width)
    rgb = np.einsum("cx,xhw->hcw", np.linalg.inv(_XYZ_FROM_RGB), planes)
    merged = rgb.reshape(height, width)
    # It divides by its largest value: the one lost factor is what makes the brightest pixels of the shortest exposure
    # right on average.
    signal = raw_dn[0] - SENSOR.black_dn
    bright = signal > SPAN_DN / 8
    return merged * (signal[bright].sum() / merged[bright].sum() * SENSOR.gain_e_per_dn / EXPOSURE_S[0])


def _pfs_frame(frame, exposure_s):
    height, width = frame.shape
    tags = {"BV": -np.log2(exposure_s), "ISO": 100, "aperture": 1, "exposure_time": f"{exposure_s:.9g}"}
    head = f"PFS1\n{width} {height // 3}\n3\n{len(tags)}\n" + "".join(f"{k}={v}\n" for k, v in tags.items())
    # Half a code more, because it cuts fractions off.
    unit = (np.maximum(frame - np.float32(SENSOR.black_dn), 0) / SPAN_DN + 0.5 / 65535).astype(np.float32)
    planes = np.einsum("xc,hcw->xhw", _XYZ_FROM_RGB, unit.reshape(-1, 3, width)).astype("<f4")
    return f"{head}X\n0\nY\n0\nZ\n0\nENDH".encode() + planes.tobytes()


def granados(raw_dn):
    """Iterated inverse-variance weights with read noise (Granados et al. 2010, eq. 6), saturated samples left out."""
    y, t = (raw_dn - SENSOR.black_dn) * SENSOR.gain_e_per_dn, EXPOSURE_S[:, None, None]
    valid = raw_dn < 0.98 * SENSOR.white_dn
    valid[0] |= ~valid.any(axis=0)
    rate = (y * valid).sum(axis=0) / (t * valid).sum(axis=0)
    for _ in range(4):
        weight = valid / (np.maximum(rate * t, 0) + SENSOR.dark_variance_e2)
        rate = (weight * t * y).sum(axis=0) / (weight * t * t).sum(axis=0)
    return rate


def hat(raw_dn):
    """Hat weights over the codes (Debevec and Malik 1997, eq. 4) on linear counts."""
    z = np.clip((raw_dn - SENSOR.black_dn) / SPAN_DN, 0, 1)
    weight = np.minimum(z, 1 - z) + 1e-6
    return (weight * z / EXPOSURE_S[:, None, None]).sum(axis=0) / weight.sum(axis=0) * FULL_E


PEERS = (
    Peer("hdrutils", hdrutils, "merge first, demosaicing left out, frames in memory, saturation 0.98", "HDRutils"),
    Peer("colour_hdri_debevec", colour_hdri_debevec, "one channel, weighting_function_Debevec1997", "colour_hdri"),
    Peer("colour_hdri_double_sigmoid", colour_hdri_double_sigmoid,
         "one channel, double_sigmoid_anchored_function", "colour_hdri"),
    Peer("opencv_debevec_u16", opencv_debevec_u16, "one channel, black subtracted, 16 bit, linear response", "cv2"),
    Peer("opencv_debevec_f32", opencv_debevec_f32, "one channel, black subtracted, float32, linear response", "cv2"),
    Peer("opencv_robertson_u16", opencv_robertson_u16, "black level in the response, 16 bit", "cv2"),
    Peer("opencv_robertson_f32", opencv_robertson_f32, "black level in the response, float32", "cv2"),
    Peer("pfshdrcalibrate", pfshdrcalibrate, "-r linear -b 16 -o 0.02, the sensor's noise parameters, piped",
         "pfshdrcalibrate"),
    Peer("granados", granados, "NumPy, four iterations, saturation 0.98", reference=True),
    Peer("hat", hat, "NumPy, hat weights over linear counts", reference=True),
)  # fmt: skip
