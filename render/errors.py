"""What can go wrong between a scene and a picture.

RenderError
├── GlUnavailableError   no OpenGL context can be had; the NumPy reference can still draw
├── ShaderError          a shader does not compile or link (names file and line)
├── MeshError            a mesh cannot be read, or has nothing that can be drawn
├── MaterialError        not a material that can be drawn, or too big for the graphics library
└── SceneError           the scene says nothing sensible: no extent, too many lights, camera inside a wall
"""


class RenderError(Exception):
    """Root of every error that the preview raises."""


class GlUnavailableError(RenderError):
    """No OpenGL context can be had on this machine."""


class ShaderError(RenderError):
    """A shader does not compile or link; the message names file and line."""


class MeshError(RenderError):
    """A mesh cannot be read or drawn."""


class MaterialError(RenderError):
    """A material cannot be drawn."""


class SceneError(RenderError):
    """The scene contradicts itself."""
