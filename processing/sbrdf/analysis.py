"""A BTF analysed into lobes, shadows, shifts and hidden clusters: SBRDF, STVS and SBRDF+ (Chen et al. 2008)."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.products import DirectionMesh, SbrdfPlus
from processing.products.arrays import Float32, Float64
from processing.products.lafortune import LafortuneTexels
from processing.progress import Progress, Silence
from processing.sbrdf.clusters import centre_count, cluster_hidden
from processing.sbrdf.flow_votes import Occlusion, vote_flow
from processing.sbrdf.lafortune import LafortuneFit, fit_lafortune, lafortune_values
from processing.sbrdf.places import moved
from processing.sbrdf.refinement import refine
from processing.sbrdf.registered import refit
from processing.sbrdf.samples import BtfViews, Samples
from processing.sbrdf.shaded_lobes import ShadedLobes, Views, fit_shaded
from processing.sbrdf.shadows import Darkness, darkness, fit_lit, shadow_map
from processing.sbrdf.supported import Support, supported
from processing.threads import in_parts

_VALUES = 1 << 24  # of samples fitted at a time: 64 MiB, and some times that for what is made of them
_PART = 16  # texels that a thread takes at a time: what is made of their samples stays in the cache
_FEW = 192  # texels that tell what counts as shadow
_STVS_ROUNDS = 2
_REGISTERED_ROUNDS = 3  # of places and lobes in turns


@dataclass(frozen=True, eq=False)
class Stvs:
    """`lobes` in 1/sr and `shadow` (light, y, x) in 0 to 1 of the texels, as if every view saw what the top sees."""

    lobes: LafortuneTexels
    shadow: Float32


@dataclass(frozen=True, eq=False)
class SbrdfAnalysis:
    """The steps' results. `scale` (1/sr) is that of the samples; `seconds` names how long each step took.

    `sbrdf` are the lobes of least squared error over all samples that these bear out (`supported`), `fit` their status,
    cost and iterations; `stvs` has
    one shadow for each light besides. `top_shadow` (light, y, x) is the paper's: BTF / SBRDF in the top view's shadows,
    1 elsewhere. `shadow_bits` (texel, bytes) are the shadowed samples, in the order of `Samples.pairs`; `shadow_status`
    (y, x) is a ShadowStatus. `voted`, `refined` and `occlusion` are shifts and hidden points after the flow, after
    the refinement and in the end. `product` is not quantised.
    """

    scale: float
    sbrdf: LafortuneTexels
    fit: LafortuneFit
    stvs: Stvs
    top_shadow: Float32
    shadow_bits: NDArray[np.uint8]
    shadow_status: NDArray[np.int8]
    voted: Occlusion
    refined: Occlusion
    occlusion: Occlusion
    product: SbrdfPlus
    seconds: dict[str, float] = field(default_factory=dict)

    def shadowed(self) -> NDArray[np.bool_]:
        """Samples in shadow (light, view, y, x)."""
        lights, views = len(self.top_shadow), len(self.occlusion.hidden)
        bits = np.unpackbits(self.shadow_bits, axis=1, count=lights * views).view(np.bool_)
        return np.ascontiguousarray(bits.T).reshape(lights, views, *self.sbrdf.shape)


def analyse(btf: BtfViews, *, report: Progress | None = None) -> SbrdfAnalysis:
    """Lobes, shadows, shifts, clusters; every step reads the BTF by rows or views.

    No lobe is brighter than `supported` allows. A texel never raises: what went wrong is in its statuses. Raises
    ImageError for fewer than three directions of
    lights or of views, or all on one line, and for another number of channels than three.
    """
    meshes = _checked(btf)
    samples, clock = Samples.of(btf), _Clock(report if report is not None else Silence())
    with clock.step("lobes"):
        plain, dark = _plain(samples, clock.report)
    with clock.step("shadows"):
        shadows = _shadows(samples, plain, dark, clock.report)
    with clock.step("flow"):
        voted = vote_flow(samples)
    with clock.step("refinement"):
        refined = refine(samples, Reconstruction(samples, shadows.shaded), voted)
    with clock.step("registered lobes"):
        shaded, occlusion = _registered(samples, shadows.shaded, refined, clock.report)
    with clock.step("clusters"):
        clusters = cluster_hidden(samples, occlusion.hidden, centre_count(*samples.shape[:4]))
    product = SbrdfPlus(
        *_in_reflectance(samples, shaded), occlusion.shift, occlusion.hidden, clusters.index,
        clusters.reflectance(samples), *meshes, btf.provenance,
    )  # fmt: skip
    height, width = samples.shape[2:4]
    sbrdf, stvs = plain.texels(height, width, samples.scale), Stvs(*_in_reflectance(samples, shadows.shaded))
    status = shadows.status.reshape(height, width)
    return SbrdfAnalysis(
        samples.scale, sbrdf, plain, stvs, _maps(shadows.top, samples), shadows.bits, status, voted, refined, occlusion,
        product, clock.seconds,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Lobes and shadows of the points seen from the top, as a view would see them, in the domain of `samples`."""

    samples: Samples
    shaded: ShadedLobes

    def seen_from(self, view: int) -> Float32:
        """Every texel of the top view under every light, (light, y, x, 3)."""
        samples = self.samples
        drawn = self.shaded.seen_along(samples.light_directions, samples.view_directions[view])
        return np.moveaxis(drawn, 0, 1).reshape(samples.shape[0], *samples.shape[2:])


class _Clock:
    """Seconds of each step."""

    def __init__(self, report: Progress) -> None:
        self.report, self.seconds = report, dict[str, float]()

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        started_s = time.perf_counter()
        yield
        self.seconds[name] = time.perf_counter() - started_s


@dataclass(frozen=True, eq=False)
class _Shadows:
    """What the shadow rounds give, texel by texel: `top` (t, light), `bits` (t, bytes), `status` (t,)."""

    shaded: ShadedLobes
    top: Float32
    bits: NDArray[np.uint8]
    status: NDArray[np.int8]


def _checked(btf: BtfViews) -> tuple[DirectionMesh, DirectionMesh]:
    lights, views, *_, channels = btf.shape
    if channels != 3:
        raise ImageError(f"a BTF of {channels} channels: lobes share their shape between three")
    if min(lights, views) < 3:
        raise ImageError(f"{lights} lights and {views} views: three or more of each are needed")
    return DirectionMesh.from_directions(btf.light_directions), DirectionMesh.from_directions(btf.view_directions)


def _texels(samples: Samples, report: Progress, description: str) -> Iterator[tuple[int, Float32]]:
    """Blocks of values (t, s, 3), and the first one's texel, in order."""
    width, first = samples.shape[3], 0
    most = max(_VALUES // (samples.shape[0] * samples.shape[1] * 3), 1)
    for rows in report.track(list(samples.row_spans()), description):
        values = samples.texels(rows)
        for start in range(0, len(values), most):
            yield first + start, values[start : start + most]
        first += (rows.stop - rows.start) * width


def _plain(samples: Samples, report: Progress) -> tuple[LafortuneFit, Darkness]:
    """The fit to all samples, and what counts as shadow, by some texels evenly spread."""
    light, view = samples.pairs()
    count = samples.shape[2] * samples.shape[3]
    wanted = np.unique(np.linspace(0, count - 1, min(_FEW, count)).astype(np.intp))
    fits, few = list[LafortuneFit](), []
    for first, values in _texels(samples, report, "lobes"):
        fits += in_parts(partial(_fit_plain, values, (light, view)), len(values), _PART)
        few.append(values[wanted[(wanted >= first) & (wanted < first + len(values))] - first])
    plain = LafortuneFit.joined(fits)
    return plain, darkness(np.concatenate(few), light, view, plain.chosen(wanted))


def _fit_plain(values: Float32, ways: tuple[Float64, Float64], start: int, stop: int) -> LafortuneFit:
    some = values[start:stop]
    return supported(fit_lafortune(some, *ways), some, ways, Support.of(some, *ways))


def _shadows(samples: Samples, plain: LafortuneFit, dark: Darkness, report: Progress) -> _Shadows:
    """Shadow rounds, then lobes and shadows of least squared error from there."""
    parts: list[_Shadows] = []
    for first, values in _texels(samples, report, "shadows"):
        block = values, plain.chosen(slice(first, first + len(values)))
        parts += in_parts(partial(_shadows_of, samples, block, dark), len(values), _PART)
    shaded = ShadedLobes.joined([part.shaded for part in parts])
    rest = (np.concatenate([getattr(part, name) for part in parts]) for name in ("top", "bits", "status"))
    return _Shadows(shaded, *rest)


def _shadows_of(
    samples: Samples, block: tuple[Float32, LafortuneFit], dark: Darkness, start: int, stop: int
) -> _Shadows:
    (light, view), values = samples.pairs(), block[0][start:stop]
    lit = fit_lit(values, light, view, block[1].chosen(slice(start, stop)), dark)
    top = np.arange(samples.shape[0]) * samples.shape[1] + samples.top
    drawn = lafortune_values(lit.lobes, light[top], view[top])
    level = shadow_map(values[:, top], drawn, lit.shadowed[:, top])
    shaped = values.reshape(len(values), *samples.shape[:2], 3)
    weight = np.isfinite(shaped.sum(axis=3)).astype(np.float32)
    seen = Views(shaped, weight, samples.light_directions, samples.view_directions)
    bits = np.packbits(lit.shadowed, axis=1)
    return _Shadows(fit_shaded(seen, lit.lobes, _STVS_ROUNDS), level, bits, lit.status)


def _registered(
    samples: Samples, shaded: ShadedLobes, refined: Occlusion, report: Progress
) -> tuple[ShadedLobes, Occlusion]:
    """Lobes and shadows of all that is seen of a point, and better places by them, in turns."""
    occlusion = refined
    shaded = refit(samples, occlusion, shaded, _STVS_ROUNDS)
    for _ in report.track(range(_REGISTERED_ROUNDS), "registered lobes"):
        occlusion = moved(samples, occlusion, shaded)
        shaded = refit(samples, occlusion, shaded, 1)
    return shaded, occlusion


def _in_reflectance(samples: Samples, shaded: ShadedLobes) -> tuple[LafortuneTexels, Float32]:
    """Lobes in 1/sr and shadows (light, y, x)."""
    return shaded.lobes.texels(samples.shape[2], samples.shape[3], samples.scale), _maps(shaded.shadow, samples)


def _maps(shadow: Float32, samples: Samples) -> Float32:
    """(texel, light) as (light, y, x)."""
    return np.ascontiguousarray(shadow.T).reshape(-1, *samples.shape[2:4])
