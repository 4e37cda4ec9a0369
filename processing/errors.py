"""What can go wrong between frames and a material.

    ProcessingError
    ├── ImageError               an image, or a set of them, cannot be used: unreadable, truncated, mixed, wrong shape
    ├── CalibrationError         too few boards, a degenerate set of views, no solution
    ├── GeometryError            triangles that cannot be used: none with an area, a vertex that is not a number
    └── ConvergenceError         an estimator stopped before it reached its optimum (raised by `check()` only)

Estimates over many pixels or texels never raise because of one of them: they carry a status.
A message says which file or view, what is wrong with it and what to do.
"""


class ProcessingError(Exception):
    """Root of every error that processing raises."""


class ImageError(ProcessingError):
    """An image or a set of images cannot be used."""


class CalibrationError(ProcessingError):
    """The views do not determine the camera."""


class GeometryError(ProcessingError):
    """Triangles cannot be used."""


class ConvergenceError(ProcessingError):
    """An estimator stopped before it reached its optimum."""
