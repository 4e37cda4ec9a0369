"""`rig import`: BTFs that others published, as products."""

from collections.abc import Callable, Iterator
from pathlib import Path

from processing.errors import ImageError
from processing.formats.ubo import Encoding, UboOptions, import_ubo
from service.files import check_new
from service.pipeline.inputs import Progress

CUT_OFF = 0.001  # share of pixels at the brightest value from which on it is told


def import_btf(source: Path, out: Path, options: UboOptions, progress: Progress) -> Iterator[str]:
    """Read a published BTF's pictures, a folder or a zip, into the product folder `out`, which must be new or empty.

    Raises ImageError for what is no such BTF, FileExistsError, FileNotFoundError.
    """
    check_new(out)
    btf = import_ubo(source, out, options, _advancing(progress, "reading pictures"))
    lights, views, height, width, _ = btf.shape
    told = btf.provenance.parameters
    yield f"{told['pictures']} pictures: {lights} lights x {views} views of {width} x {height} texels"
    if (lack := lights * views - told["pictures"]) > 0:
        yield f"{lack} pairs of a light and a view have no picture: they are taken as not measured"
    if told["brightest"] > CUT_OFF:
        yield f"{told['brightest']:.1%} of the pixels are of the brightest value: highlights may be cut off there"
    yield f"{out}: `rig analyse {out}` takes it apart"


def options_of(region: str, size: str, white: float, *, linear: bool) -> UboOptions:
    """From LEFT,TOP,WIDTH,HEIGHT and WIDTH,HEIGHT in pixels, each empty for all. Raises ImageError."""
    cut = _numbers(region, "region", "LEFT,TOP,WIDTH,HEIGHT")
    texels = _numbers(size, "size", "WIDTH,HEIGHT")
    return UboOptions(
        Encoding.LINEAR if linear else Encoding.SRGB,
        white,
        (cut[1], cut[0], cut[3], cut[2]) if cut else None,
        (texels[1], texels[0]) if texels else None,
    )


def _numbers(text: str, name: str, form: str) -> list[int]:
    if not text:
        return []
    parts = text.split(",")
    if len(parts) != form.count(",") + 1 or not all(part.strip().isdecimal() for part in parts):
        raise ImageError(f"{name} {text!r}: whole numbers are needed, {form} in pixels.")
    return [int(part) for part in parts]


def _advancing(progress: Progress, description: str) -> Callable[[int, int], None]:
    """Tell a progress how many of all are done, whose items are otherwise counted as they are taken."""
    bars: list[Iterator[int]] = []
    at = 0

    def report(done: int, count: int) -> None:
        nonlocal at
        if not bars:
            bars.append(progress.track(range(count), description))
            next(bars[0], None)
        for _ in range(done - at):
            next(bars[0], None)
        at = done

    return report
