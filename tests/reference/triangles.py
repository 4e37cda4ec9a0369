"""Rays against triangles by trying all of them, but those that bounding rectangles rule out."""

import numpy as np

SMALL_M = 0.0015


class Triangles:
    """Triangles (n, 3, 3): corners. Those wider than `SMALL_M` are always tried."""

    def __init__(self, corners: np.ndarray) -> None:
        left, right = corners[..., 0].min(axis=1), corners[..., 0].max(axis=1)
        small = right - left <= SMALL_M
        order = np.argsort(left[small])
        self.left, self.small, self.large = left[small][order], corners[small][order], corners[~small]

    def first_crossing(self, start: np.ndarray, way: np.ndarray) -> float:
        """Share of the way at which it first meets a triangle, infinity where it meets none."""
        return float(self.crossings(start, way).min(initial=np.inf))

    def crossings(self, start: np.ndarray, way: np.ndarray) -> np.ndarray:
        """Shares of the way at which it meets triangles, in order."""
        return self._met(start, way)[0]

    def nesting(self, start: np.ndarray, way: np.ndarray) -> int:
        """Of how many bodies at once the way is inside at most, when it starts outside all."""
        return int(np.cumsum(np.sign(self._met(start, way)[1])).max(initial=0))

    def _met(self, start: np.ndarray, way: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Shares in order, and for each a number above 0 where the way goes in (Moller and Trumbore 1997)."""
        origin, second, third = np.moveaxis(self._near(start, way), 1, 0)
        edge1, edge2, offset = second - origin, third - origin, start - origin
        side, across = np.cross(way, edge2), np.cross(offset, edge1)
        scale = (edge1 * side).sum(axis=1)
        parallel = scale == 0
        scale[parallel] = 1.0
        u, v, share = (offset * side).sum(axis=1) / scale, across @ way / scale, (edge2 * across).sum(axis=1) / scale
        met = np.flatnonzero(~parallel & (u >= 0) & (v >= 0) & (u + v <= 1) & (share >= 0) & (share <= 1))
        order = met[np.argsort(share[met])]
        return share[order], scale[order]

    def _near(self, start: np.ndarray, way: np.ndarray) -> np.ndarray:
        low, high = np.minimum(start, start + way), np.maximum(start, start + way)
        first, last = np.searchsorted(self.left, [low[0] - SMALL_M, high[0]])
        y = self.small[first:last, :, 1]
        beside = (y > high[1]).all(axis=1) | (y < low[1]).all(axis=1)
        return np.concatenate([self.small[first:last][~beside], self.large])
