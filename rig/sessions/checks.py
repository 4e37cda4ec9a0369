"""Is this the frame that was asked for? Asked of every frame before its step counts as done."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite, nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.config import RigConfig
from rig.devices import FileFormat, RawFrame
from rig.errors import FrameCheckError
from rig.sessions.mosaic import Mosaic, decode, decode_jpeg, noise_profile
from rig.sessions.plan import EXPOSURE_STEP_S, in_steps_s
from rig.sessions.step import Step

EXPOSURE_TOLERANCE = 0.02  # relative: cameras round their shutter times; a bracket's neighbour differs by far more
LIT_QUANTILE = 0.995  # hot pixels are rarer than 1 in 200, a laser's stripe is more frequent
LIT_SIGMA = 5.0  # of read noise; without light that quantile lies at 2.6 sigma
MOSTLY = 0.5
_SAMPLED_PX = 200_000
_ASSUMED_READ_NOISE = 0.001  # of the range, where the file does not tell


@dataclass(frozen=True, slots=True)
class Shot:
    """What one camera delivered for one step: its file, or its burst decoded as (time, row, column) with attributes.

    `file_format` is that of the file.
    """

    camera: str
    exposure_s: float
    taken_s: float
    transferred_bytes: int
    data: bytes | None
    burst: NDArray[np.uint16] | None
    attributes: Mapping[str, Any]
    file_format: FileFormat = FileFormat.RAW

    @property
    def frames(self) -> int:
        """Number of frames in it."""
        return 1 if self.burst is None else len(self.burst)


class FrameChecks:
    """The checks of one session; remembers each camera's last frame to know a frozen one."""

    def __init__(self, config: RigConfig, steps: Sequence[Step]) -> None:
        self._config = config
        self._last: dict[str, bytes] = {}
        self._longest: dict[object, float] = {}
        self._iso: dict[str, float] = {}
        for step in steps:
            self._longest[_light(step)] = max(step.exposure_s, self._longest.get(_light(step), 0.0))

    def take(self, step: Step, camera: str, frames: Sequence[RawFrame]) -> tuple[Shot, list[str]]:
        """The frames as what is to be stored, with what is odd but no reason to take them again.

        Raises FrameCheckError: number, serial number, exposure, not a raw image, frozen, or dark although lit, with not
        even a spot (only in sweeps and in the longest exposure of each light: a shorter one may hold no light worth the
        name; a board held by hand may show a camera its dark side).
        """
        self._check_labels(step, camera, frames)
        decoded = decode if step.file_format is FileFormat.RAW else decode_jpeg
        mosaics = [decoded(frame.data, camera) for frame in frames]
        self._check_fresh(camera, mosaics)
        profile = noise_profile(frames[0].data) if step.file_format is FileFormat.RAW else None
        warnings = self._check_iso(camera, frames) + self._check_levels(step, camera, mosaics, profile)
        transferred = sum(len(frame.data) for frame in frames)
        exposure_s, taken_s = frames[0].exposure_s, frames[0].taken_s
        if not step.sweep:
            data = frames[0].data
            return Shot(camera, exposure_s, taken_s, transferred, data, None, {}, step.file_format), warnings
        assert mosaics[0].cfa is not None, "sweeps are raw"
        attributes = {
            "exposure_s": exposure_s, "interval_s": _interval_s(frames), "serial": frames[0].serial, "taken_s": taken_s,
            "times_s": [frame.taken_s - taken_s for frame in frames],
            "black_dn": mosaics[0].black_dn, "white_dn": mosaics[0].white_dn,
            "cfa": [list(row) for row in mosaics[0].cfa], "noise_profile": list(profile) if profile else None,
        }  # fmt: skip
        burst = np.stack([mosaic.raw_dn for mosaic in mosaics])
        return Shot(camera, exposure_s, taken_s, transferred, None, burst, attributes), warnings

    def _check_labels(self, step: Step, camera: str, frames: Sequence[RawFrame]) -> None:
        if len(frames) != step.frames:
            raise FrameCheckError(f"{camera}: {len(frames)} frames came, {step.frames} were asked for.")
        expected = self._config.cameras[camera].serial
        counted = step.exposure_s == in_steps_s(step.exposure_s)  # else a shutter speed, which is taken as it is
        tolerance_s = EXPOSURE_TOLERANCE * step.exposure_s + (EXPOSURE_STEP_S / 2 if counted else 0.0)
        for frame in frames:
            if frame.serial != expected:
                raise FrameCheckError(
                    f"{camera}: expected serial {expected}, frame carries {frame.serial}: the cable is in another port."
                )
            if abs(frame.exposure_s - step.exposure_s) > tolerance_s:
                raise FrameCheckError(
                    f"{camera}: exposed for {frame.exposure_s:.6g} s where {step.exposure_s:.6g} s were asked for."
                )
            if frame.file_format is not step.file_format:
                raise FrameCheckError(
                    f"{camera}: a .{frame.file_format} came where a .{step.file_format} was asked for."
                )

    def _check_iso(self, camera: str, frames: Sequence[RawFrame]) -> list[str]:
        """A camera that chooses the ISO itself changes its noise, and maybe its tone curve, within a bracket."""
        before, now = self._iso.get(camera, nan), frames[-1].iso
        self._iso[camera] = now
        changed = isfinite(before) and isfinite(now) and before != now
        return [f"{camera}: ISO {now:g} after {before:g}: set the ISO by hand."] if changed else []

    def _check_fresh(self, camera: str, mosaics: Sequence[Mosaic]) -> None:
        if len({mosaic.raw_dn.shape for mosaic in mosaics}) > 1:
            raise FrameCheckError(f"{camera}: the frames of one burst differ in size.")
        last = self._last.get(camera)
        for mosaic in mosaics:
            digest = hashlib.sha256(mosaic.raw_dn.tobytes()).digest()
            if digest == last and mosaic.raw_dn.min() < mosaic.raw_dn.max():  # white all over is no sign of freezing
                raise FrameCheckError(f"{camera}: the frame is identical to the one before: the camera is frozen.")
            last = digest
        if last is not None:
            self._last[camera] = last

    def _check_levels(
        self, step: Step, camera: str, mosaics: Sequence[Mosaic], profile: Sequence[float] | None
    ) -> list[str]:
        range_dn = mosaics[0].white_dn - mosaics[0].black_dn
        read_dn = range_dn * (profile[1] ** 0.5 if profile and profile[1] > 0 else _ASSUMED_READ_NOISE)
        light_dn = max(_bright_level_dn(mosaic) for mosaic in mosaics)
        warnings = []
        dark = light_dn < LIT_SIGMA * read_dn
        if (
            (step.lamps or step.sweep)
            and dark
            and not any(_has_spot(mosaic, LIT_SIGMA * read_dn) for mosaic in mosaics)
        ):
            source = "laser" if step.sweep else " + ".join(step.lamps)
            finding = f"{camera}: no light of {source} in the frame ({light_dn:.1f} dn over black)"
            if _held_by_hand(step):
                warnings.append(f"{finding}: the board is turned away from this camera, or from the lamp.")
            elif step.sweep or step.exposure_s == self._longest[_light(step)]:
                raise FrameCheckError(f"{finding}: the lamp is dead or hidden.")
            else:
                warnings.append(f"{finding}; a longer exposure of it has to carry this light.")
        saturated = max(float(np.mean(_sampled(mosaic) >= mosaic.white_dn)) for mosaic in mosaics)
        if (step.lamps or step.sweep) and saturated > MOSTLY:  # before a light box it is meant
            warnings.append(f"{camera}: {saturated:.0%} of the frame is saturated.")
        return warnings


def _interval_s(frames: Sequence[RawFrame]) -> float:
    """Between two frames of a burst as the camera took it, which may differ a little from what was asked for."""
    return (frames[-1].taken_s - frames[0].taken_s) / max(len(frames) - 1, 1)


def _held_by_hand(step: Step) -> bool:
    """Whether the step photographs a tilted board, not the one of pose 0, which lies on the turntable."""
    return (step.mount or {}).get("pose", 0) != 0


def _light(step: Step) -> object:
    return step.pose, step.lamps, step.sweep, tuple(sorted((step.mount or {}).items()))


def _bright_level_dn(mosaic: Mosaic) -> float:
    return float(np.quantile(_sampled(mosaic), LIT_QUANTILE)) - mosaic.black_dn


def _has_spot(mosaic: Mosaic, least_dn: float) -> bool:
    """Whether four neighbours are all this bright: a lamp seen in a mirror ball is; hot pixels stand alone."""
    rows = np.minimum(mosaic.raw_dn[:-1], mosaic.raw_dn[1:])
    return bool(np.minimum(rows[:, :-1], rows[:, 1:]).max() > mosaic.black_dn + least_dn)


def _sampled(mosaic: Mosaic) -> NDArray[np.uint16]:
    """Every pixel of a small frame, an odd stride through a large one, so that all colours are met."""
    stride = mosaic.raw_dn.size // _SAMPLED_PX | 1
    return mosaic.raw_dn.ravel()[::stride]
