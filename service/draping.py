"""A material on an object of one's own: the SRF made for its mesh, and the mesh with the frames that it is in."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from processing.errors import ImageError
from processing.materials.skin import Skin, SkinOptions, drape
from processing.products import Provenance, Srf
from render.mesh import Mesh, perpendicular
from render.mesh_file import save_mesh
from service.files import filled
from service.viewing import SKIN_MESH, is_skin, mesh_named


def drape_product(product: Path, mesh: str, out: Path, repeats: float, size: int, seed: int = 0) -> str:
    """Make the SRF of `product` over a mesh, by file or by name, into the folder `out`; returns what was done.

    `repeats` is how many widths of the sample go into the mesh's longest side. An earlier skin in `out` stays until the
    new one is there. Raises ImageError and MeshError, NotADirectoryError where `out` is a file.
    """
    if is_skin(product):
        raise ImageError(f"{product}: a skin for one mesh; drape the SRF that it was made from")
    if out.resolve() == product.resolve():
        raise ImageError(f"{out}: the skin would take the place of the SRF that it is made from; name another folder")
    with filled(out) as part:
        skin = _write_skin(part, Srf.load(product), mesh, repeats, size, seed)
    height, width = skin.srf.residual.shape[1:3]
    patches, triangles = int(skin.patch.max()) + 1, len(skin.triangles)
    return f"{out}: {patches} patches on {triangles} triangles, {width} x {height} texels; `rig preview {out}` draws it"


def _write_skin(folder: Path, srf: Srf, mesh: str, repeats: float, size: int, seed: int) -> Skin:
    body = mesh_named(mesh)
    extent = float(np.ptp(body.positions, axis=0).max())
    skin = drape(srf, body.positions, body.normals, body.triangles, SkinOptions(extent / repeats, size, seed))
    normals = body.normals[skin.vertex]
    tangents = np.column_stack([perpendicular(skin.tangents, normals), np.ones(len(normals))])
    drawn = Mesh(body.positions[skin.vertex], normals, tangents, skin.uv, skin.triangles)
    made_with = {"skin": {"mesh": Path(mesh).name, "repeats": repeats, "size": size, "seed": seed}}
    origin = srf.provenance
    provenance = Provenance(origin.frames, origin.calibration, origin.parameters | made_with)
    save_mesh(folder / SKIN_MESH, drawn)
    replace(skin.srf, provenance=provenance).save(folder)
    return skin
