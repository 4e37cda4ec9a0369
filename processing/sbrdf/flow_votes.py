"""Where each view's points are seen from the top: optical flow under every light, and the vote of the lights."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from processing.products.arrays import Float32
from processing.sbrdf.samples import Samples

Mask = NDArray[np.bool_]

HIDDEN_ABOVE = 0.7  # the paper's threshold of HiddenRatio
_APART = 0.2  # texels that forward and backward flow may miss each other by: what meets so is closest to the truth
_ALIKE = 12.0  # grey levels that a point may differ by from what its flow leads to: 0.3 deviations
_AGREE = 0.7  # texels within which two motion vectors are one vote
_LIGHTS = 27  # that are asked of a view, where there are more: the vote's outcome hardly changes with the rest
_LEAST_TEXTURE = 0.005  # deviation of a picture over its mean: below there is nothing to follow
_LEAST_SIDE = 32  # texels of a picture for the flow: smaller tiles are repeated more often
_MIDDLE, _DEVIATION = 100.0, 40.0  # of the 8 bits that the flow reads


@dataclass(frozen=True, eq=False)
class Occlusion:
    """What each view sees of the points that are seen from the top.

    `shift` (view, y, x, 2) float32, texels right and down, leads from a texel of a view to that of the top view which
    sees the same point, and is 0 where there is none; the tile repeats. `hidden` (view, y, x): no point seen from the
    top. `hidden_ratio` (view, y, x) float32: share of the lights whose flow found none, 0 where no light could tell.
    """

    shift: Float32
    hidden: Mask
    hidden_ratio: Float32


def vote_flow(samples: Samples) -> Occlusion:
    """Flow from each view to the top view under every light, and its majority over the lights (Chen et al., 2.3.1).

    A light takes part in a view where both pictures are lit, finite and textured. A point is hidden where of more than
    0.7 of these lights forward and backward flow do not meet, or lead to what looks different. Its motion vector is the
    mean of the largest group of vectors within 0.7 texels of one of them. A view without such lights has no hidden
    points and no shift.
    """
    _, views, height, width, _ = samples.shape
    top = pictures_of(samples.seen_from(samples.top))
    found = Occlusion(
        np.zeros((views, height, width, 2), np.float32),
        np.zeros((views, height, width), bool),
        np.zeros((views, height, width), np.float32),
    )

    def vote(view: int) -> None:
        flows, meets = flows_between(pictures_of(samples.seen_from(view)), top, dense_inverse_search())
        if len(flows):
            count_votes(flows, meets, found.shift[view], found.hidden_ratio[view])
            found.hidden[view] = found.hidden_ratio[view] > HIDDEN_ABOVE

    others = [view for view in range(views) if view != samples.top]
    with _one_thread_each(), ThreadPoolExecutor(numba.get_num_threads()) as pool:
        for _ in pool.map(vote, others):
            pass  # raises what a view raised
    return found


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """OpenCV's own threads gain nothing on small pictures while the views share the cores."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


@dataclass(frozen=True, eq=False)
class Pictures:
    """Grey pictures (light, y, x) uint8 of like mean and deviation, which texels were measured, and which tell."""

    grey: NDArray[np.uint8]
    measured: Mask
    telling: Mask


def pictures_of(values: Float32) -> Pictures:
    """What a view sees under every light (light, y, x, channel), as flow reads it."""
    grey = values.mean(axis=-1)
    measured = np.isfinite(grey)
    count = np.maximum(measured.sum(axis=(1, 2)), 1)
    known = np.where(measured, grey, 0.0).astype(np.float64)
    mean = known.sum(axis=(1, 2)) / count
    apart = np.where(measured, known - mean[:, None, None], 0.0)
    deviation = np.sqrt((apart**2).sum(axis=(1, 2)) / count)
    telling = (mean > 0) & (deviation > _LEAST_TEXTURE * mean)
    scaled = _MIDDLE + apart * (_DEVIATION / np.where(telling, deviation, 1.0))[:, None, None]
    return Pictures(np.clip(np.rint(scaled), 0, 255).astype(np.uint8), measured, telling)


def flows_between(view: Pictures, top: Pictures, flow: cv2.DenseOpticalFlow) -> tuple[Float32, Mask]:
    """Flow (light, y, x, 2) of the lights that tell, from the view to the top view, and where it holds."""
    height, width = view.grey.shape[1:]
    around = tuple(max(side // 4, (_LEAST_SIDE - side + 1) // 2) for side in (height, width))
    flows, meets = [], []
    telling = np.flatnonzero(view.telling & top.telling)
    for light in telling[:: -(-len(telling) // _LIGHTS) or 1]:
        pictures = [np.pad(some.grey[light], [(n, n) for n in around], mode="wrap") for some in (view, top)]
        forth, back = (_followed(flow, *pair) for pair in (pictures, pictures[::-1]))
        inside = (slice(around[0], around[0] + height), slice(around[1], around[1] + width))
        met = (_meet(forth, back) & _alike(forth, *pictures))[inside] & view.measured[light]
        flows.append(forth[inside])
        meets.append(met & _lands_on(forth[inside], top.measured[light]))
    if not flows:
        return np.zeros((0, height, width, 2), np.float32), np.zeros((0, height, width), bool)
    return np.stack(flows), np.stack(meets)


def dense_inverse_search() -> cv2.DenseOpticalFlow:
    """Dense inverse search down to the pictures' own resolution: what is to be followed is a few texels wide."""
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    flow.setFinestScale(0)
    flow.setPatchSize(5)
    flow.setPatchStride(2)
    return flow


def _followed(flow: cv2.DenseOpticalFlow, start: NDArray[np.uint8], end: NDArray[np.uint8]) -> Float32:
    return np.asarray(flow.calc(start, end, np.zeros((*start.shape, 2), np.float32)), np.float32)


def _meet(forth: Float32, back: Float32) -> Mask:
    """Where the flow there and the flow back from there end near the start."""
    met: Mask = ((forth + _carried(back, forth)) ** 2).sum(axis=-1) < _APART**2
    return met


def _alike(forth: Float32, start: NDArray[np.uint8], end: NDArray[np.uint8]) -> Mask:
    """Where the flow leads to what looks the same: one that finds nothing often stands still, there and back."""
    alike: Mask = np.abs(_carried(end.astype(np.float32), forth) - start) < _ALIKE
    return alike


def _carried(picture: Float32, flow: Float32) -> Float32:
    """What lies where the flow leads to; NaN beyond the picture."""
    rows, columns = np.mgrid[: flow.shape[0], : flow.shape[1]].astype(np.float32)
    places = columns + flow[..., 0], rows + flow[..., 1]
    return cv2.remap(picture, *places, cv2.INTER_LINEAR, None, cv2.BORDER_CONSTANT, np.nan).astype(np.float32)


def _lands_on(flow: Float32, measured: Mask) -> Mask:
    height, width = measured.shape
    rows, columns = np.mgrid[:height, :width]
    rows = (rows + np.rint(flow[..., 1]).astype(np.intp)) % height
    columns = (columns + np.rint(flow[..., 0]).astype(np.intp)) % width
    landed: Mask = measured[rows, columns]
    return landed


@numba.njit(cache=True, nogil=True)
def count_votes(flows: Float32, meets: Mask, shift: Float32, ratio: Float32) -> None:
    """Of each texel the mean of the largest group of vectors that meet, and the share of those that do not."""
    lights, height, width, _ = flows.shape
    near = np.float32(_AGREE * _AGREE)
    kept = np.empty((lights, 2), np.float32)
    for y in range(height):
        for x in range(width):
            count = 0
            for light in range(lights):
                if meets[light, y, x]:
                    kept[count] = flows[light, y, x]
                    count += 1
            ratio[y, x] = 1 - count / lights
            most = 0
            for i in range(count):
                votes, right, down = 0, 0.0, 0.0
                for j in range(count):
                    dx, dy = kept[j, 0] - kept[i, 0], kept[j, 1] - kept[i, 1]
                    if dx * dx + dy * dy <= near:
                        votes += 1
                        right += kept[j, 0]
                        down += kept[j, 1]
                if votes > most:
                    most = votes
                    shift[y, x, 0], shift[y, x, 1] = right / votes, down / votes
