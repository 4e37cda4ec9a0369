"""The samples of a material by direction and texel, in the form that lobes and residuals are fitted to."""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.materials.phong import LobeSamples
from processing.products import (
    Btf,
    LightStack,
    Lobe,
    NormalMap,
    ReflectanceMaps,
    half_vectors,
    plane_points,
    sphere_normals,
    tangent_frames,
)
from processing.products.arrays import Float32, Float64
from processing.products.directions import falloff

_UNKNOWN = 1e-30  # a variance beside which any misfit is large: samples of a channel then count alike


@dataclass(frozen=True, eq=False)
class Measurements:
    """Samples (direction, texel, 3): `value` f with the cosine inside and its `variance`; NaN = none.

    `light` and `view` are unit vectors away from the surface in each texel's tangent frame (t, b, n), (direction,
    texel, 3); an axis of length 1 stands for one that they do not change along.
    """

    value: Float32
    variance: Float32
    light: Float64
    view: Float64

    @property
    def cos_light(self) -> Float64:
        """N.L, (direction, texel or 1)."""
        return self.light[..., 2]

    @property
    def half(self) -> Float64:
        """H in the tangent frame, (direction, texel or 1, 3)."""
        return half_vectors(self.light, self.view)

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Lit samples with a value and a variance, (direction, texel, 3)."""
        measured = np.isfinite(self.value) & np.isfinite(self.variance) & (self.variance > 0)
        return np.asarray(measured & (self.cos_light > 0)[..., None], np.bool_)

    def delta(self, lobe: Lobe) -> Float64:
        """R - f (the paper's eq. 4), NaN where there is no sample."""
        light, view = np.broadcast_arrays(self.light, self.view)
        f = lobe.evaluate(light.reshape(-1, 3), view.reshape(-1, 3)).reshape(light.shape)
        return np.asarray(self.value - f, np.float64)

    def lobe_samples(self, model_variance: Float64) -> LobeSamples:
        """All samples in one list; `model_variance` (3,) is what the lobe cannot follow, on top of the noise."""
        shape = self.value.shape[:2]
        return LobeSamples(
            self.value.reshape(-1, 3).astype(np.float64),
            np.broadcast_to(self.cos_light, shape).ravel(),
            np.broadcast_to(self.half[..., 2], shape).ravel(),
            (self.variance + model_variance).reshape(-1, 3),
        )

    def directions(self, chosen: NDArray[np.intp] | slice) -> "Measurements":
        """The samples of some directions."""
        return Measurements(
            self.value[chosen],
            self.variance[chosen],
            self.light[chosen],
            self.view if len(self.view) == 1 else self.view[chosen],
        )

    def texels(self, chosen: NDArray[np.intp] | slice) -> "Measurements":
        """The samples of some texels."""
        if isinstance(chosen, np.ndarray) and np.array_equal(chosen, np.arange(self.value.shape[1])):
            return self
        return Measurements(
            self.value[:, chosen],
            self.variance[:, chosen],
            self.light if self.light.shape[1] == 1 else self.light[:, chosen],
            self.view if self.view.shape[1] == 1 else self.view[:, chosen],
        )

    def thinned(self, most: int) -> "Measurements":
        """At most so many samples per channel, or one texel: those of evenly spread texels."""
        directions, texels = self.value.shape[:2]
        return self.texels(slice(None, None, max(-(-texels // max(most // max(directions, 1), 1)), 1)))

    def misfit_variance(self, error: Float64) -> Float64:
        """`misfit_variance` (3,) of an `error` (direction, texel, 3)."""
        valid = self.valid
        return misfit_variance(*(np.where(valid, one, 0.0).reshape(-1, 3).T for one in (error, self.variance)))


def misfit_variance(error: Float64, variance: Float64) -> Float64:
    """What a model cannot follow, as a variance per channel beyond the samples' own; arguments (channel, sample).

    (sum e^4 / 3 - sum v^2) / sum e^2, at least 0. Nothing where the errors are noise of these variances, the variance
    of a misfit that is everywhere and normal, and a third of its square where it sits in few samples, as in highlights:
    a mean over all would leave those next to no weight, as they are the brightest and so the noisiest.
    """
    square = np.asarray(error, np.float64) ** 2
    total = square.sum(axis=1)
    beyond = (square**2).sum(axis=1) / 3 - (np.asarray(variance, np.float64) ** 2).sum(axis=1)
    return np.asarray(np.where(total > 0, np.maximum(beyond, 0.0) / np.where(total > 0, total, 1.0), 0.0), np.float64)


def sphere_measurements(maps: ReflectanceMaps) -> Measurements:
    """The samples of a sphere; raises ImageError where the maps have not three channels."""
    lights, count = len(maps.reflectance_cos), maps.reflectance_cos.shape[1] ** 2
    if maps.reflectance_cos.shape[-1] != 3:
        raise ImageError(f"reflectance maps have {maps.reflectance_cos.shape[-1]} channels, an SRF has 3")
    normal = sphere_normals(maps.reflectance_cos.shape[1])
    frames, points = tangent_frames(normal).reshape(-1, 3, 3), normal.reshape(-1, 3)
    eye = np.array([[0.0, 0.0, -1.0]])
    return Measurements(
        maps.reflectance_cos.reshape(lights, count, 3),
        maps.variance.reshape(lights, count, 3),
        local_directions(frames, points, maps.light_directions, maps.light_distances),
        local_directions(frames, points, eye, np.array([maps.view_distance])),
    )


def btf_measurements(btf: Btf, texels: NDArray[np.intp]) -> Measurements:
    """The samples of some texels of a BTF, row after row, by pair of light and view; nothing is known of their noise.

    Raises ImageError where the BTF has not three channels.
    """
    if btf.shape[-1] != 3:
        raise ImageError(f"the BTF has {btf.shape[-1]} channels, an SRF has 3")
    light, view = _pairs(btf)
    value = btf.reflectance.reshape(len(light), -1, 3)[:, texels] * light[:, 2, None, None].astype(np.float32)
    return Measurements(value, np.full(value.shape, _UNKNOWN, np.float32), light[:, None], view[:, None])


def mean_over_texels(btf: Btf) -> Measurements:
    """The samples of one texel that is the mean of all that are valid, by pair of light and view."""
    light, view = _pairs(btf)
    valid = np.isfinite(btf.reflectance)
    count = valid.sum(axis=(2, 3))
    total = np.sum(btf.reflectance, axis=(2, 3), where=valid, dtype=np.float64)
    mean = np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0).reshape(-1, 3)
    value = (mean * light[:, 2:]).astype(np.float32)[:, None]
    return Measurements(value, np.full(value.shape, _UNKNOWN, np.float32), light[:, None], view[:, None])


def stack_measurements(stack: LightStack, normals: NormalMap, texels: NDArray[np.intp]) -> Measurements:
    """The samples of some pixels of an object, row after row, each for the light that reaches the pixel's own place."""
    lights, shape = len(stack.reflectance_cos), stack.reflectance_cos.shape[1:3]
    points = plane_points((shape[0], shape[1]), stack.pixel_m)
    points[..., 2] = normals.depth_m
    points = points.reshape(-1, 3)[texels]
    frames = view_frames(normals.normals.reshape(-1, 3)[texels].astype(np.float64))
    value, variance = (array.reshape(lights, -1, 3)[:, texels] for array in (stack.reflectance_cos, stack.variance))
    places = zip(stack.light_directions, stack.light_distances_m, strict=True)
    farther = np.stack([falloff(points, direction, distance_m) for direction, distance_m in places])
    return Measurements(
        (value / farther[..., None]).astype(np.float32),
        (variance / farther[..., None] ** 2).astype(np.float32),
        local_directions(frames, points, stack.light_directions, stack.light_distances_m),
        local_directions(frames, points, np.array([[0.0, 0.0, 1.0]]), np.array([np.inf])),
    )


def view_frames(normal: Float64) -> Float64:
    """Rows t, b, n (..., 3, 3) of `tangent_frames` for normals in a view frame: x right, y up, z toward the camera."""
    turned = np.array([1.0, -1.0, -1.0])
    return np.asarray(tangent_frames(normal * turned) * turned, np.float64)


def _pairs(btf: Btf) -> tuple[Float64, Float64]:
    """Light and view (pair, 3) of every pair in the order of the BTF's axes."""
    lights, views = len(btf.light_directions), len(btf.view_directions)
    return np.repeat(btf.light_directions, views, axis=0), np.tile(btf.view_directions, (lights, 1))


def local_directions(frames: Float64, points: Float64, directions: Float64, distances: Float64) -> Float64:
    """Unit vectors (direction, point, 3) in the frames of the points toward each place.

    `frames` (point, 3, 3) have t, b, n as rows; a place lies at `distances` (direction,), which may be infinite, along
    `directions` (direction, 3), in the unit and the frame of `points` (point, 3).
    """
    arrays = (np.ascontiguousarray(array, np.float64) for array in (frames, points, directions, distances))
    return np.asarray(_local_directions(*arrays), np.float64)


@numba.njit(cache=True, parallel=True)
def _local_directions(frames: Float64, points: Float64, directions: Float64, distances: Float64) -> Float64:
    out = np.empty((len(directions), len(points), 3))
    for p in numba.prange(len(points)):
        for d in range(len(directions)):
            x, y, z = directions[d, 0], directions[d, 1], directions[d, 2]
            if distances[d] < np.inf:
                x = x * distances[d] - points[p, 0]
                y = y * distances[d] - points[p, 1]
                z = z * distances[d] - points[p, 2]
            length = np.sqrt(x * x + y * y + z * z)
            for axis in range(3):
                turned = frames[p, axis, 0] * x + frames[p, axis, 1] * y + frames[p, axis, 2] * z
                out[d, p, axis] = turned / length
    return out
