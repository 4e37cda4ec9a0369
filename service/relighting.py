"""`rig export` and `rig rti`: pictures for relighting viewers, of products and of other people's photographs."""

from collections.abc import Iterator
from math import degrees
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from processing.errors import ImageError
from processing.formats.light_positions import write_lp
from processing.formats.ptm import write_ptm
from processing.formats.relight import write_relight
from processing.formats.rti import write_rti
from processing.materials.photometric_stereo import find_normals
from processing.materials.ptm import (
    PtmFit,
    PtmStatus,
    Values,
    as_lrgb,
    btf_pictures,
    fit_ptm,
    map_pictures,
    reproduction_db,
    stack_pictures,
)
from processing.products import LightStack, NormalMap, ReflectanceMaps, RelightableImage, ResidualBasis, StoredBtf
from processing.products.arrays import Float64
from render.picture import save_image
from service.files import check_folder, filled, replaced
from service.light_photographs import ENDING, PhotographFiles, read_photographs
from service.viewing import kind_of

PTM, RTI = ".ptm", ".rti"
PICTURE, WEB, STACK, NORMALS, LIGHTS = "picture.ptm", "web", "light_stack", "normals", "lights.lp"


def export_product(product: Path, out: Path, *, luminance: bool = False, harmonics: bool = False) -> Iterator[str]:
    """Write what a product's camera saw as a relightable image, and say how well it holds.

    `out` is a .ptm, a .rti, or a folder for web viewers; `luminance` writes one colour per pixel, `harmonics` nine
    hemispherical harmonics in the folder instead of a polynomial. A .lp has the pictures themselves beside it, for
    other programs. Raises ImageError where the product or the ending is of another kind.
    """
    harmonics = harmonics or out.suffix.lower() == RTI
    _check_out(out, luminance=luminance, harmonics=harmonics)
    values, lights = _pictures(product)
    if out.suffix.lower() == ENDING:
        _write_photographs(out, values, lights)
        yield f"{out}: lights of {len(lights)} pictures, {out.stem}-*.png beside it"
        return
    fit = fit_ptm(values, lights, ResidualBasis.HEMISPHERICAL if harmonics else ResidualBasis.BIQUADRATIC)
    image = as_lrgb(fit.image) if luminance else fit.image
    yield from _about(fit, reproduction_db(image, values, lights), len(lights))
    _write(out, image)
    height, width = fit.status.shape
    yield f"{out}: {width} x {height} pixels over {image.basis}"


def relight_photographs(
    files: PhotographFiles, out: Path, *, pixel_m: float = 1e-3, unequal_lights: bool = False
) -> Iterator[str]:
    """Turn photographs under known lights into what relighting and shape need, all in the folder `out`.

    A .ptm and a web folder of the photographs themselves, the list of their lights, and the products light_stack, which
    `export_product` takes, and normals. With `unequal_lights` all of it is as if the lights were equally strong.
    Nothing is written where something is wrong. Raises ImageError.
    """
    check_folder(out)
    if out.resolve() in (files.source.resolve(), files.source.resolve().parent):
        raise ImageError(f"{out}: the photographs lie there; name another folder for the results.")
    photographs = read_photographs(files)
    if files.chrome is not None:
        yield _about_lights(photographs.lights)
    if unequal_lights:
        photographs = photographs.of_equal_lights()
        weakest, strongest = photographs.strengths.min(), photographs.strengths.max()
        yield f"the strongest light is {strongest / weakest:.2f} times as strong as the weakest: made equal"
    values, lights = photographs.display_values(), photographs.lights
    fit = fit_ptm(values, lights)
    yield from _about(fit, reproduction_db(fit.image, values, lights), len(lights))
    stack = photographs.stack(pixel_m)
    normals = find_normals(stack)
    yield _about_normals(normals)
    with filled(out) as part:
        write_ptm(part / PICTURE, fit.image)
        write_relight(part / WEB, fit.image)
        stack.save(part / STACK)
        normals.save(part / NORMALS)
        save_image(part / f"{NORMALS}.png", normal_picture(normals))
        write_lp(part / LIGHTS, list(photographs.names), lights)
    yield f"{out / PICTURE}: for RTI viewers; {WEB}: for web viewers; {STACK}: for `rig export`"
    yield f"{out / NORMALS}.png: normals, x y z as red green blue; {NORMALS}: the product"


def _about_lights(lights: Float64) -> str:
    elevations = np.degrees(np.arcsin(lights[:, 2]))
    return f"{len(lights)} lights in the chrome sphere, {elevations.min():.0f} to {elevations.max():.0f} deg high"


def normal_picture(normals: NormalMap) -> NDArray[np.uint8]:
    """x, y and z of the normals, -1 to 1, as red, green and blue (y, x, 3); black where there is none."""
    codes = np.rint(127.5 * (np.nan_to_num(normals.normals) + 1))
    return np.where(normals.measured[..., None], codes, 0).astype(np.uint8)


def _about_normals(normals: NormalMap) -> str:
    if not normals.measured.any():
        return "no normals: four lights or more, not in one plane, must reach a pixel that is not saturated"
    angle = degrees(float(np.sqrt(np.median(normals.variance[normals.measured]))))
    return f"normals of {normals.measured.mean():.1%} of the pixels, to {angle:.2f} deg (median of one sigma)"


def _check_out(out: Path, *, luminance: bool, harmonics: bool) -> None:
    if out.suffix.lower() not in (PTM, RTI, ENDING, ""):
        raise ImageError(
            f"{out}: a polynomial texture map is {PTM}, harmonics are {RTI}, pictures with their lights {ENDING}; "
            "no ending means a folder."
        )
    if luminance and out.suffix.lower() != PTM:
        raise ImageError(f"{out}: one colour per pixel is known of {PTM} only; leave --luminance out.")
    if harmonics and out.suffix.lower() in (PTM, ENDING):
        raise ImageError(f"{out}: harmonics are {RTI}, or a folder; leave --harmonics out.")
    check_folder(out)


def _pictures(product: Path) -> tuple[Values, Float64]:
    kind = kind_of(product)
    if kind == "light_stack":
        return stack_pictures(LightStack.load(product))
    if kind == "btf":
        return btf_pictures(StoredBtf.open(product))
    if kind == "reflectance_maps":
        return map_pictures(ReflectanceMaps.load(product))
    raise ImageError(
        f"{product}: a {kind} holds no pictures; reflectance_maps, a light_stack or a btf can be exported."
    )


def _write_photographs(out: Path, values: Values, lights: Float64) -> None:
    """Pictures of 8 bits, black where nothing was measured, and the list of their lights."""
    names = [f"{out.stem}-{number:03d}.png" for number in range(1, len(lights) + 1)]
    with filled(out.parent) as part:
        for name, picture in zip(names, values, strict=True):
            save_image(part / name, np.rint(255 * np.clip(np.nan_to_num(picture), 0, 1)).astype(np.uint8))
        write_lp(part / out.name, names, lights)


def _write(out: Path, image: RelightableImage) -> None:
    if not out.suffix:
        with filled(out) as part:
            write_relight(part, image)
        return
    write = write_ptm if out.suffix.lower() == PTM else write_rti
    with replaced(out) as part:
        write(part, image)


def _about(fit: PtmFit, quality_db: float, lights: int) -> Iterator[str]:
    if fit.rank < fit.image.basis.size:
        yield (
            f"WARNING: the {lights} lights determine {fit.rank} of {fit.image.basis.size} coefficients, the shortest "
            "solution was taken: under lights far from them the picture is a guess."
        )
    gaps = np.bincount(fit.status.ravel(), minlength=len(PtmStatus))
    if gaps[PtmStatus.NO_VALUES]:
        yield f"{gaps[PtmStatus.NO_VALUES] / fit.status.size:.1%} of the pixels were not measured and are black"
    yield f"differs from the {lights} pictures by {quality_db:.1f} dB (peak signal to noise)"
