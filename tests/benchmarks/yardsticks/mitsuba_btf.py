"""A measured BTF in Mitsuba 3, looked up as public plugins for it do: the four nearest pairs of directions.

Distances are in the six numbers of light and view; the four values are weighted by their inverses; a KD-tree finds
them, NumPy reads them, behind a BSDF in Python. Written for this comparison from that description; no code is shared.
"""

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from processing.products import Btf

VARIANT = "scalar_rgb"
_NEIGHBOURS = 4
_NAME = "measured_btf_of_the_benchmark"
Array = NDArray[Any]


class NearestPairs:
    """Values (n, 3) of a BTF between its pairs of directions, texels by the nearest."""

    def __init__(self, btf: Btf) -> None:
        lights, views = btf.light_directions, btf.view_directions
        self.values = np.nan_to_num(btf.reflectance).reshape(-1, *btf.shape[2:])
        pairs = np.hstack([np.repeat(lights, len(views), axis=0), np.tile(views, (len(lights), 1))])
        self.tree = KDTree(pairs)

    def __call__(self, uv: Array, light: Array, view: Array) -> Array:
        """Reflectance times the cosine to the light, for (n, 2), (n, 3) and (n, 3)."""
        distance, pair = self.tree.query(np.hstack([light, view]), k=_NEIGHBOURS)
        weight = 1.0 / np.maximum(distance, 1e-6)
        size = self.values.shape[1:3]
        rows, columns = (np.floor(uv[:, 1 - k] * size[k]).astype(np.intp) % size[k] for k in (0, 1))
        found = self.values[pair, rows[:, None], columns[:, None]]
        blended = np.einsum("nk,nkc->nc", weight / weight.sum(axis=1, keepdims=True), found)
        return np.asarray(blended * np.maximum(light[:, 2:], 0.0))


def rendered(btf: Btf, size: int, samples: int = 1) -> tuple[float, Array]:
    """Seconds per shaded sample and the picture of a plane that fills it, under one distant light.

    Raises ImportError where mitsuba is not installed.
    """
    import mitsuba as mi  # type: ignore[import-not-found, unused-ignore]

    mi.set_variant(VARIANT)
    mi.register_bsdf(_NAME, lambda props: _bsdf_class(mi)(props, NearestPairs(btf)))
    look = mi.ScalarTransform4f().look_at(origin=[0.8, -0.8, 1.6], target=[0, 0, 0], up=[0, 0, 1])
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0},
            "sensor": {
                "type": "perspective",
                "fov": 20.0,
                "to_world": look,
                "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
                "sampler": {"type": "independent", "sample_count": samples},
            },
            "plane": {"type": "rectangle", "bsdf": {"type": _NAME}},
            "light": {"type": "directional", "direction": [-0.5, 0.3, -0.8], "irradiance": 1.0},
        }
    )
    mi.render(scene, spp=1)
    begun_s = time.perf_counter()
    picture = np.array(mi.render(scene, spp=samples))
    return (time.perf_counter() - begun_s) / (size * size * samples), picture


def _bsdf_class(mi: Any) -> Any:
    """The BSDF over a look-up."""

    class MeasuredBtf(mi.BSDF):  # type: ignore[misc]
        def __init__(self, props: Any, look_up: NearestPairs) -> None:
            mi.BSDF.__init__(self, props)
            self.look_up = look_up
            flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide | mi.BSDFFlags.SpatiallyVarying
            self.m_components = [flags]
            self.m_flags = flags

        def eval(self, ctx: Any, si: Any, wo: Any, active: bool = True) -> Any:
            if si.wi[2] <= 0 or wo[2] <= 0:
                return mi.Color3f(0.0)
            uv, light, view = (np.array([list(v)], np.float64) for v in (si.uv, wo, si.wi))
            return mi.Color3f(*self.look_up(uv, light, view)[0].tolist())

        def pdf(self, ctx: Any, si: Any, wo: Any, active: bool = True) -> float:
            return max(float(wo[2]), 0.0) / np.pi

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: bool = True) -> Any:
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def sample(self, ctx: Any, si: Any, sample1: float, sample2: Any, active: bool = True) -> Any:
            found = mi.BSDFSample3f()
            found.wo = mi.warp.square_to_cosine_hemisphere(sample2)
            found.pdf = self.pdf(ctx, si, found.wo)
            found.eta = 1.0
            found.sampled_type = +mi.BSDFFlags.DiffuseReflection
            found.sampled_component = 0
            return found, self.eval(ctx, si, found.wo) / max(found.pdf, 1e-9)

        def to_string(self) -> str:
            return "MeasuredBtf"

    return MeasuredBtf
