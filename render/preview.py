"""Pictures of scenes: by OpenGL where there is one, else by the NumPy reference."""

import logging
from collections.abc import Iterable
from dataclasses import replace
from types import TracebackType
from typing import Protocol, Self

from render.errors import GlUnavailableError, SceneError
from render.opengl import GlRenderer
from render.picture import Picture
from render.reference import ReferenceRenderer
from render.scene import Scene

log = logging.getLogger(__name__)


class Renderer(Protocol):
    """What turns a scene into a picture."""

    name: str
    affordable_supersampling: int

    def draw(self, scene: Scene) -> Picture:
        """The scene as its camera sees it."""
        ...

    def release(self) -> None:
        """Give everything that is held back."""
        ...


def open_renderer() -> Renderer:
    """OpenGL, or the NumPy reference with one warning in the log where no OpenGL can be had."""
    try:
        return GlRenderer()
    except GlUnavailableError as error:
        log.warning("%s. The NumPy reference draws instead.", error)
        return ReferenceRenderer()


class Preview:
    """A window of `size` (width, height) without a screen, used as a context manager, by one thread at a time.

    Each pixel is the average of `supersampling` x `supersampling` samples; left out, of as many as the renderer draws
    in reasonable time. Without a `renderer` it opens one by `open_renderer`; `renderer_name` says what draws.
    Raises SceneError for a window without pixels.
    """

    def __init__(
        self, size: tuple[int, int], *, supersampling: int | None = None, renderer: Renderer | None = None
    ) -> None:
        self.resize(size)
        self._renderer = renderer if renderer is not None else open_renderer()
        self._supersampling = supersampling or self._renderer.affordable_supersampling

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self._size

    @property
    def renderer_name(self) -> str:
        """GL_RENDERER, or that the NumPy reference draws."""
        return self._renderer.name

    def resize(self, size: tuple[int, int]) -> None:
        """Another window from the next picture on."""
        if min(size) < 1:
            raise SceneError(f"a window of {size[0]} x {size[1]} pixels shows nothing")
        self._size = size

    def draw(self, scene: Scene) -> Picture:
        """The scene, its camera fitted to this window; radiance is linear float32."""
        camera = scene.camera.resized(self._size).scaled(self._supersampling)
        return self._renderer.draw(replace(scene, camera=camera)).averaged(self._supersampling)

    def draw_all(self, scenes: Iterable[Scene]) -> list[Picture]:
        """One picture per scene; see `scene.orbiting_light`."""
        return [self.draw(scene) for scene in scenes]

    def close(self) -> None:
        """Give the renderer's memory back; nothing can be drawn afterwards."""
        self._renderer.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
