"""Relit frames past bodies that stand still: by a graphics card's compute shaders where there are any."""

import logging

import numpy as np
from numpy.typing import NDArray

from processing.lighting.cached_kernel import frame_in_threads
from processing.lighting.kept_steps import KeptSteps
from processing.lighting.lobe_nodes import Surface, room_for_nodes
from processing.products.arrays import Float32, Float64
from render import cached_frame
from render.context import is_software
from render.errors import GlUnavailableError

_log = logging.getLogger(__name__)


class FrameOnCard:
    """A `CachedFrame` of compute shaders, for one relighting. Raises GlUnavailableError where there are none."""

    def __init__(self) -> None:
        self._frames = cached_frame.CachedFrames()
        self.name = self._frames.name

    def __call__(self, kept: KeptSteps, vertices: NDArray[np.int64], surface: Surface, sums: Float64) -> Float32:
        """Radiance (n, 3), as by `frame_in_threads` but for rounding in float32; by it where the card has no room."""
        if kept.filled[1] > self._frames.most_steps:
            _log.info("%d steps are more than %s takes: threads find this body's light", kept.filled[1], self.name)
            return frame_in_threads(kept, vertices, surface, sums)
        steps = cached_frame.StepFunctions(*kept.steps(vertices), store=kept, filled=kept.filled)
        return self._frames.radiance(steps, _for_card(surface), sums)

    def release(self) -> None:
        """Give everything on the card back."""
        self._frames.release()


class FrameInThreads:
    """The same by the processor's threads."""

    def __call__(self, kept: KeptSteps, vertices: NDArray[np.int64], surface: Surface, sums: Float64) -> Float32:
        """Radiance (n, 3)."""
        return frame_in_threads(kept, vertices, surface, sums)

    def release(self) -> None:
        """Nothing is held."""


def open_cached_frame() -> FrameOnCard | FrameInThreads:
    """By a graphics card, or by the processor's threads with a line in the log that says why."""
    try:
        card = FrameOnCard()
    except GlUnavailableError as error:
        _log.info("%s. Threads of the processor find relit frames.", error)
        return FrameInThreads()
    if is_software(card.name):
        _log.info("%s is no graphics card. Threads of the processor find relit frames.", card.name)
        card.release()
        return FrameInThreads()
    return card


def _for_card(surface: Surface) -> cached_frame.Surface:
    nodes = room_for_nodes(len(surface.means) // 2, surface.heights)
    least = np.maximum(1 - nodes.limits, 0.0)
    return cached_frame.Surface(*surface[:5], least, nodes.below, surface.means)
