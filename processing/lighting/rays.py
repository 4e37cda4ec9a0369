"""Which directions triangles block, by Embree (Wald et al. 2014)."""

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from processing.products.arrays import Float32, Float64, Int32

BATCH = 1 << 17  # rays that are asked for at a time: what is made of them stays in the cache

Bool = NDArray[np.bool_]


class Occluder:
    """Triangles (m, 3) between vertices (n, 3), which block light from both sides; several threads may ask at once."""

    def __init__(self, vertices: Float64, triangles: Int32) -> None:
        self._scene = EmbreeScene(robust=True)  # rays do not slip through where triangles meet
        # Embree reads the arrays as long as it is asked, so that they must live as long as the scene.
        self._mesh = TriangleMesh(
            self._scene, np.ascontiguousarray(vertices, np.float32), np.ascontiguousarray(triangles, np.int32)
        )
        self.blocks(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))  # builds the hierarchy, in one thread

    def blocks(self, origins: Float32, directions: Float32) -> Bool:
        """Which rays (n,) from points (n, 3) in directions (n, 3) meet a triangle."""
        return np.asarray(self._scene.run(origins, directions, query="OCCLUDED") == 0)

    def first_hits(self, origins: Float32, directions: Float32) -> Int32:
        """Number of the triangle that each ray (n,) meets first, or -1."""
        return np.asarray(self._scene.run(origins, directions, query="INTERSECT"), np.int32)
