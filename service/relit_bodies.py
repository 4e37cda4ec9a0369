"""Meshes as bodies that are relit: one vertex of the body for each of the mesh, and what was amiss with the mesh."""

from processing.lighting.triangle_body import TriangleBody, triangle_body
from render.closed_mesh import is_closed
from render.mesh import Mesh


def body_of(mesh: Mesh) -> tuple[TriangleBody, tuple[str, ...]]:
    """The body of a mesh, and a sentence for each of its faults that it can be relit with.

    Triangles without an area are left out. Of an open mesh both sides block light, and light is caught on the side that
    the triangles face. Raises GeometryError where no triangle has an area.
    """
    body = triangle_body(mesh.positions, mesh.triangles, mesh.normals)
    told = []
    if flat := len(mesh.triangles) - len(body.triangles):
        told.append(f"{flat} of {len(mesh.triangles)} triangles have no area and are left out")
    if not is_closed(mesh):
        told.append("the mesh is open: its triangles block light from both sides, and are lit on the side they face")
    return body, tuple(told)
