"""A headless OpenGL context over EGL, or one clear error."""

from typing import Any

import moderngl

from render.errors import GlUnavailableError

REQUIRED_VERSION = 330
# moderngl annotates its free keywords as dictionaries, which they are not.
_EGL: dict[str, Any] = {"backend": "egl"}


def open_context() -> moderngl.Context:
    """A standalone context, current in no thread: `with context:` makes it so.

    Which library serves is left to EGL; without a graphics card that is Mesa's software rasteriser.
    Raises GlUnavailableError where none can be had.
    """
    try:
        context = moderngl.create_context(REQUIRED_VERSION, True, **_EGL)
    except Exception as error:
        # The loader raises bare Exceptions, and each library words them in its own way.
        raise GlUnavailableError(
            f"no OpenGL {REQUIRED_VERSION / 100:.1f} context over EGL ({error}); "
            "install libegl1 and libgl1-mesa-dri to draw with OpenGL"
        ) from error
    # A new context is current in the thread that made it and could not be used in another; leaving it undoes that.
    with context:
        return context


def renderer_name(context: moderngl.Context) -> str:
    """GL_RENDERER: the card or the software rasteriser that draws."""
    with context:
        return str(context.info["GL_RENDERER"])


def is_software(name: str) -> bool:
    """Whether a renderer of this name draws on the processor: Mesa's, Google's or Microsoft's."""
    return any(known in name.lower() for known in ("llvmpipe", "softpipe", "swiftshader", "basic render driver"))
