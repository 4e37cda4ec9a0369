"""The commands of `rig` that make one thing of another: materials analysed, draped, exported; pictures of other rigs.

As in `service.cli`, what computes or draws is imported by the command that needs it.
"""

from pathlib import Path
from typing import Annotated

import typer

from service.console import ConsoleProgress, reported_errors, tell

materials = typer.Typer()


@materials.command("import")
def import_(
    source: Annotated[Path, typer.Argument(help="Folder or zip of one BTF's pictures.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the new product.")],
    linear: Annotated[bool, typer.Option("--linear", help="Values are in proportion to light, not sRGB.")] = False,
    white: Annotated[
        float, typer.Option(help="Value, 0 to 1 in proportion to light, of a perfect diffuser under light from above.")
    ] = 1.0,
    region: Annotated[
        str, typer.Option(metavar="LEFT,TOP,WIDTH,HEIGHT", help="Part of the pictures that is taken, in pixels.")
    ] = "",
    size: Annotated[
        str, typer.Option(metavar="WIDTH,HEIGHT", help="Texels that this is averaged down to; all pixels unless given.")
    ] = "",
) -> None:
    """Make the product btf of a published BTF: a picture for each pair of directions, named as in Bonn's UBO2003.

    Names end in `tl015 pl060 tv030 pv090.jpg` (or .png): polar angle and azimuth of the light, then of the view, in
    degrees. What is read how: docs/analyse-a-btf.md
    """
    from service import importing

    with reported_errors(), ConsoleProgress() as progress:
        options = importing.options_of(region, size, white, linear=linear)
        for line in importing.import_btf(source, out, options, progress):
            tell(line)


@materials.command()
def analyse(
    product: Annotated[Path, typer.Argument(metavar="BTF", help="Folder of a btf, of the rig or imported.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results, new or empty.")],
) -> None:
    """Take a BTF apart into SBRDF+: lobes, shadows, shifts and hidden points, as pictures, figures and a product.

    The product draws as the BTF does and is some thirty times smaller; the pictures show each step and the result
    beside the BTF. What it needs and writes: docs/analyse-a-btf.md
    """
    from service import analysing

    with reported_errors(), ConsoleProgress() as progress:
        for line in analysing.analyse_product(product, out, progress):
            tell(line)


@materials.command()
def join(
    btf: Annotated[Path, typer.Argument(metavar="BTF", help="Folder of a processed btf session.")],
    mdf: Annotated[Path, typer.Argument(metavar="MDF", help="Folder of a processed mdf session of the same sample.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the new material.")],
) -> None:
    """Join what a sample looks like and how deep it is to a material with silhouettes, parallax and shadows.

    Both sessions have the same texels, depth_mm, cameras and angles of the turntable: docs/silhouettes-and-shadows.md
    """
    from service import joining

    with reported_errors():
        for line in joining.join_sessions(btf, mdf, out):
            tell(line)


@materials.command()
def drape(
    product: Annotated[Path, typer.Argument(metavar="SRF", help="Folder of an SRF.")],
    mesh: Annotated[str, typer.Argument(help="A mesh file (OBJ, PLY, GLB), or sphere, torus, vase, statue.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the SRF made for this mesh, and the mesh.")],
    repeats: Annotated[
        float, typer.Option(help="Widths of the sample that go into the mesh's longest side.", min=0.1, max=100)
    ] = 3.0,
    size: Annotated[int, typer.Option(help="Texels on a side of the texture, about at most.", min=64, max=8192)] = 1024,
    seed: Annotated[int, typer.Option(help="Of the choice between places that fit alike.")] = 0,
) -> None:
    """Grow an SRF over a mesh without seams, from patches of the sample that fit their neighbours."""
    from service import draping

    with reported_errors():
        tell(draping.drape_product(product, mesh, out, repeats, size, seed))


@materials.command()
def merge(
    files: Annotated[list[Path], typer.Argument(help="Bracketed photographs: RAW or DNG, or JPEG with EXIF.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Linear picture to write (.exr).")],
    measured_times: Annotated[
        bool, typer.Option("--measured-times", help="Of RAW: go by the frames where they contradict their times.")
    ] = False,
    moved: Annotated[bool, typer.Option("--moved", help="Merge although the camera moved between them.")] = False,
    sensor: Annotated[
        Path | None, typer.Option(help="Of RAW: the camera's measured sensor, a folder products/sensors/SERIAL.")
    ] = None,
    response: Annotated[
        Path | None, typer.Option(help="Of JPEG: the camera's response, saved (.json) by an earlier merge.")
    ] = None,
    grey_patch: Annotated[
        str, typer.Option(metavar="LEFT,TOP,WIDTH,HEIGHT", help="Pixels that are grey, for the white balance.")
    ] = "",
) -> None:
    """Merge bracketed photographs into one linear EXR with a variance layer, and a tone-mapped PNG beside it."""
    from processing.radiometry.stack import MergeOptions
    from service import measuring

    with reported_errors():
        options = MergeOptions(measured_times, moved)
        for line in measuring.merge_photographs(files, out, options, sensor, response, grey_patch):
            tell(line)


@materials.command()
def displacement(
    source: Annotated[
        Path, typer.Argument(help="Folder of laser-line photographs or of a scan, GIF of a sweep, or TOML of a scan.")
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Depth picture (.png) or point cloud (.ply, .glb); the other is beside.")
    ],
) -> None:
    """Measure range in laser images that another rig took: stripe, laser plane, depth picture and point cloud.

    A folder is photographs of the stripe on a chessboard, with board.toml or their MATLAB calibration, or a scan with
    its scan.toml; a GIF is a laser swept by hand before two printed rectangles, with intrinsics.xml beside it or none;
    a TOML describes pictures of an object on a turntable or a stage before a laser that stands. What each needs:
    docs/range-of-your-own-images.md
    """
    from service import ranging

    with reported_errors(), ConsoleProgress() as progress:
        for line in ranging.measure_displacement(source, out, lambda frames: progress.track(frames, source.stem)):
            tell(line)


@materials.command()
def export(
    product: Annotated[Path, typer.Argument(help="Folder of a product: reflectance_maps, a light_stack or a btf.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="A .ptm, an .rti, a folder for web viewers, or an .lp.")],
    luminance: Annotated[
        bool, typer.Option("--luminance", help="One colour per pixel, only its brightness follows the light (LRGB).")
    ] = False,
    harmonics: Annotated[
        bool, typer.Option("--harmonics", help="Of a folder: hemispherical harmonics, closer to gloss than a PTM.")
    ] = False,
) -> None:
    """Write a product for relighting viewers: polynomial texture map, RTI, or a folder for the web.

    RTIViewer and others open .ptm and .rti, OpenLIME and Relight the folder; an .lp has the pictures beside it, for
    programs that fit for themselves: docs/relight-your-own-photographs.md
    """
    from service import relighting

    with reported_errors():
        for line in relighting.export_product(product, out, luminance=luminance, harmonics=harmonics):
            tell(line)


@materials.command()
def rti(
    source: Annotated[Path, typer.Argument(help="Folder of photographs, with an .lp of their lights, or that .lp.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results.")],
    mask: Annotated[Path | None, typer.Option(help="Picture that is not black where the object is.")] = None,
    chrome: Annotated[
        Path | None, typer.Option(help="Without .lp: picture that is not black where a chrome sphere is.")
    ] = None,
    unequal_lights: Annotated[
        bool, typer.Option("--unequal-lights", help="Find how strong each light was; the object must be curved.")
    ] = False,
    linear: Annotated[bool, typer.Option("--linear", help="Counts are in proportion to light, not sRGB.")] = False,
    pixel_mm: Annotated[float, typer.Option(help="Side of a pixel on the object.", min=1e-6)] = 1.0,
) -> None:
    """Relight photographs that another camera took under one light after another, and measure normals from them.

    --chrome lies among the photographs of the sphere, which are all pictures of that folder: those of the object, if
    the sphere stands beside it, or as many others under the same lights, in the same order of names.
    What it needs and writes: docs/relight-your-own-photographs.md
    """
    from service import relighting
    from service.light_photographs import PhotographFiles

    with reported_errors():
        files = PhotographFiles(source, mask, chrome, linear)
        for line in relighting.relight_photographs(files, out, pixel_m=pixel_mm / 1e3, unequal_lights=unequal_lights):
            tell(line)


@materials.command()
def relight(
    scene: Annotated[Path, typer.Argument(help="A scene (.toml), such as docs/scenes/room.toml.")],
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Picture (.png, .jpg), or moving light (.webp, .gif, .apng).")
    ],
    size: Annotated[str, typer.Option(metavar="WIDTH,HEIGHT", help="Pixels of the picture.")] = "720,480",
    light_azimuth_deg: Annotated[
        float | None, typer.Option(help="By how much the light is turned, +X toward +Y; else as the scene says.")
    ] = None,
    move: Annotated[
        str, typer.Option(metavar="BODY,X,Y", help="Put a body there (mm); in a moving picture it goes there and back.")
    ] = "",
    frames: Annotated[int, typer.Option(help="Of a moving picture.", min=2, max=1000)] = 24,
    precomputed: Annotated[
        Path, typer.Option(help="Folder that keeps what was computed once; it may be deleted.")
    ] = Path("precomputed"),
) -> None:
    """Light a scene of bodies by the light of a place: with shadows, from all around, as a picture or moving.

    The scene names meshes, materials (also captured ones), an environment (`rig environment` makes one) and a camera.
    What each vertex sees of the light, and what each body hides of it, is computed once and kept by content: the first
    picture takes seconds to minutes, later ones a moment, whatever moves or turns. docs/design-the-light.md
    """
    from service.relit_drawing import Wanted, draw_scene

    with reported_errors(), ConsoleProgress() as progress:
        wanted = Wanted(size, light_azimuth_deg, move, frames)
        for line in draw_scene(scene, out, precomputed, wanted, progress):
            tell(line)


@materials.command()
def environment(
    sources: Annotated[
        list[Path],
        typer.Argument(metavar="SOURCE...", help="A panorama (.exr, .hdr), folders FRONT BACK, or all photographs."),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the new product.")],
    field_deg: Annotated[float, typer.Option(help="Of view of the fish-eye, which its image circle shows.")] = 190.0,
    size: Annotated[int, typer.Option(help="Texels along a side of the cubemap.", min=8, max=1024)] = 128,
    azimuth_deg: Annotated[
        float, typer.Option(help="Where the front, or a panorama's middle, looks; from +X toward +Y.")
    ] = 0.0,
    mask: Annotated[
        Path | None, typer.Option(help="Picture that is not black where the lens's frame is mirrored; else looked for.")
    ] = None,
    hide: Annotated[
        list[str] | None,
        typer.Option(metavar="LEFT,TOP,WIDTH,HEIGHT", help="Pixels where the frame is mirrored; may be repeated."),
    ] = None,
    keep_reflections: Annotated[
        bool, typer.Option("--keep-reflections", help="Do not look for the frame's reflections.")
    ] = False,
    turn: Annotated[
        str, typer.Option(metavar="X,Y,Z", help="Degrees by which front to back is off half a turn; else found.")
    ] = "",
    lens: Annotated[
        Path | None,
        typer.Option(help="Calibrated fish-eye: JSON of OpenCV's matrix and distortion."),
    ] = None,
    panorama: Annotated[
        Path | None, typer.Option(help="Write the light as an equirectangular picture as well (.exr, .hdr).")
    ] = None,
) -> None:
    """Make an environment, the light of a place, of two bracketed fish-eye photographs, or of a panorama.

    Photographs in one folder are told apart by their times and exposures; in two, the front's are named first.
    What it needs and writes: docs/light-of-a-place.md
    """
    from service.environment import PlaceOptions, make_environment

    with reported_errors():
        options = PlaceOptions(field_deg, size, azimuth_deg, mask, tuple(hide or ()), not keep_reflections, turn, lens)
        for line in make_environment(sources, out, options, panorama):
            tell(line)
