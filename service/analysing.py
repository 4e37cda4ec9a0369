"""`rig analyse`: a BTF taken apart, as a product, pictures and figures in words."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.products import Btf
from processing.products.arrays import Float32
from processing.sbrdf.analysis import SbrdfAnalysis
from processing.sbrdf.drawn import DrawnLobes, DrawnPlus, View, ViewErrors, view_errors
from processing.sbrdf.samples import Samples
from service.files import check_new, filled
from service.pipeline.inputs import Progress
from service.pipeline.sbrdf import analysed, check_analysable
from service.sbrdf_pictures import display, draw_errors, draw_steps, draw_table, shift_colours, shift_scale
from service.viewing import kind_of

Array = NDArray[np.float64]

PRODUCT, STEPS, RECONSTRUCTION, ERRORS = "sbrdf_plus", "steps.png", "reconstruction.png", "errors.png"
_RING_DEG = 4.0  # views whose angles from the normal follow each other closer stand together
_LOW_DEG = 60.0  # from the normal: the light and the view whose steps are shown are the nearest to it


def analyse_product(product: Path, out: Path, progress: Progress) -> Iterator[str]:
    """Analyse the BTF in a product folder into the folder `out`, which must be new or empty; tells what was found.

    Raises ImageError for what is no BTF and for one whose directions or values cannot carry it, FileExistsError.
    """
    check_new(out)
    if (kind := kind_of(product)) != "btf":
        raise ImageError(
            f"{product}: a {kind} is no BTF; `rig process` makes one of a btf session, `rig import` reads one"
        )
    btf = Btf.load(product)
    try:
        check_analysable(btf)
    except ImageError as error:
        raise ImageError(f"{product}: cannot be analysed: {error}") from error
    found = analysed(btf, progress)
    models = drawn_models(btf, found)
    errors = {
        name: view_errors(btf, drawn, progress.track(range(btf.shape[1]), f"error of {name}"))
        for name, drawn in models.items()
    }
    with filled(out) as part:
        found.product.save(part / PRODUCT)
        _draw(part, btf, found, models, errors)
    yield from _about(btf, found, errors)
    yield f"{out / PRODUCT}: {found.product.size_bytes / 1e6:.3g} MB; `rig preview {out / PRODUCT}` draws it"
    yield f"{out}: {STEPS}, {RECONSTRUCTION}, {ERRORS}"


def drawn_models(btf: Btf, found: SbrdfAnalysis) -> dict[str, View]:
    """How the three models draw a measured view; SBRDF+ as it is packed."""
    directions = btf.light_directions, btf.view_directions
    return {
        "SBRDF": DrawnLobes(found.sbrdf, *directions).seen_from,
        "STVS": DrawnLobes(found.stvs.lobes, *directions, found.stvs.shadow).seen_from,
        "SBRDF+": DrawnPlus(found.product.quantised()).seen_from,
    }


def _about(btf: Btf, found: SbrdfAnalysis, errors: Mapping[str, ViewErrors]) -> Iterator[str]:
    """The figures of an analysis in words."""
    lights, views, height, width, _ = btf.shape
    yield f"{lights} lights x {views} views of {width} x {height} texels, {btf.reflectance.size / 1e6:.3g} MB at 8 bits"
    missing = float(np.isnan(btf.reflectance).any(axis=-1).mean())
    if missing:
        yield f"{missing:.1%} of the samples were not measured and took no part"
    yield f"{float(found.shadowed().mean()):.1%} of the samples lie in shadow"
    voted, refined = (float(step.hidden.mean()) for step in (found.voted, found.occlusion))
    yield f"{voted:.1%} of the points are hidden from the top by the flow's vote, {refined:.1%} after the refinement"
    told = ", ".join(f"{name} {error.relative():.2%}" for name, error in errors.items())
    yield f"squared error over the squares of the BTF: {told}"


def _draw(
    folder: Path, btf: Btf, found: SbrdfAnalysis, models: Mapping[str, View], errors: Mapping[str, ViewErrors]
) -> None:
    draw_steps(folder / STEPS, _steps(btf, found))
    rows, titles = _reconstructions(btf, models)
    draw_table(folder / RECONSTRUCTION, rows, titles)
    rings = _rings(btf.view_directions)
    relative = {name: np.array([error.relative(views) for views in rings.values()]) for name, error in errors.items()}
    draw_errors(folder / ERRORS, np.array(list(rings)), relative)


def _steps(btf: Btf, found: SbrdfAnalysis) -> list[tuple[str, NDArray[np.floating]]]:
    """What each step found, of one low light and one slanted view."""
    samples = Samples.of(btf)
    light, view, top = _near(btf.light_directions, _LOW_DEG), _near(btf.view_directions, _LOW_DEG), samples.top
    shadowed = found.shadowed()
    seen = {number: display(samples.seen_from(number)[light], 1.0) for number in (top, view)}
    shift, hidden = found.product.shift[view], found.product.hidden[view]
    scale = shift_scale(shift, hidden)
    return [
        (f"from the top, {_polar(btf.light_directions, light)} light", seen[top]),
        ("samples in shadow there (black)", 1.0 - shadowed[light, top]),
        ("top view shadow of that light", found.top_shadow[light]),
        ("shadow over all views (STVS)", found.stvs.shadow[light]),
        (f"a view of {_polar(btf.view_directions, view)}", seen[view]),
        (f"its shifts: red right, green up; full: {scale:.2g} texels", shift_colours(shift, hidden, scale)),
        ("white: hidden by the flow's vote", found.voted.hidden[view].astype(np.float32)),
        ("white: hidden after the refinement", hidden.astype(np.float32)),
    ]


def _reconstructions(btf: Btf, models: Mapping[str, View]) -> tuple[list[tuple[str, Sequence[Float32]]], list[str]]:
    """The top, a slanted and the lowest view under a high and a low light: the BTF, and each model of it."""
    samples = Samples.of(btf)
    lights = (_near(btf.light_directions, 30.0), _near(btf.light_directions, _LOW_DEG))
    views = dict.fromkeys((samples.top, _near(btf.view_directions, 40.0), int(btf.view_directions[:, 2].argmin())))
    rows: list[tuple[str, Sequence[Float32]]] = []
    for view in views:
        seen = [samples.seen_from(view), *(drawn(view) / np.float32(samples.scale) for drawn in models.values())]
        for light in dict.fromkeys(lights):
            name = f"view {_polar(btf.view_directions, view)}\nlight {_polar(btf.light_directions, light)}"
            rows.append((name, [display(one[light], 1.0) for one in seen]))
    return rows, ["BTF", *models]


def _rings(views: Array) -> dict[float, NDArray[np.intp]]:
    """Which views (n, 3) stand at about the same angle from the normal, by that angle in degrees."""
    angle_deg = _angles_deg(views)
    order = np.argsort(angle_deg, kind="stable")
    breaks = np.flatnonzero(np.diff(angle_deg[order]) > _RING_DEG) + 1
    return {float(angle_deg[ring].mean()): ring for ring in np.split(order, breaks)}


def _near(directions: Array, polar_deg: float) -> int:
    return int(np.abs(_angles_deg(directions) - polar_deg).argmin())


def _polar(directions: Array, number: int) -> str:
    return f"{_angles_deg(directions)[number]:.0f} deg"


def _angles_deg(directions: Array) -> Array:
    """From the normal (n,)."""
    return np.asarray(np.degrees(np.arccos(np.clip(directions[:, 2], -1, 1))), np.float64)
