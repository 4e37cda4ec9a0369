"""Radiance of vertices leaf by leaf: every direction of the tree with its light, its visibility and its reflectance."""

import numpy as np

from processing.lighting.rays import Occluder


def frame(normal):
    """Tangent, bitangent and normal as rows (3, 3); the tangent is level."""
    level = np.hypot(normal[0], normal[1])
    tangent = np.array([-normal[1], normal[0], 0]) / level if level > 1e-6 else np.array([1.0, 0, 0])
    return np.stack([tangent, np.cross(normal, tangent), normal])


def radiance_of(visible_cos, light, directions, normal, toward_eye, brdf):
    """Sum over the leaves of light (leaves, 3), visibility times cosine (leaves,) and reflectance."""
    axes = frame(normal)
    view = axes @ toward_eye
    view[2] = max(view[2], 1e-3)
    lit = directions @ axes.T
    lit[:, 2] = np.maximum(lit[:, 2], 1e-3)
    reflectance = brdf.evaluate(lit, np.broadcast_to(view, lit.shape))
    return (visible_cos[:, None] * light * reflectance).sum(axis=0)


class DirectLight:
    """Every ray from every vertex against the triangles of all bodies, in the world's frame (eq. 2 of the paper).

    Bodies must not be turned: their leaves are the world's.
    """

    def __init__(self, bodies, poses, sampled):
        vertices = [b.vertices + p[:3, 3] for b, p in zip(bodies, poses, strict=True)]
        shift = np.cumsum([0, *(len(v) for v in vertices)])
        triangles = [b.triangles + s for b, s in zip(bodies, shift, strict=False)]
        self._occluder = Occluder(np.concatenate(vertices), np.concatenate(triangles).astype(np.int32))
        self._bodies, self._poses, self._sampled, self._first = bodies, poses, sampled, shift

    def visible_cos(self, vertex):
        """Visibility times cosine (leaves,) of a vertex, with its body, origin and number there."""
        number = int(np.searchsorted(self._first, vertex, side="right")) - 1
        own = vertex - self._first[number]
        body, shift = self._bodies[number], self._poses[number][:3, 3]
        origin, normal = body.origins[own] + shift, body.normals[own]
        cosine = self._sampled.directions @ normal
        above = np.flatnonzero(cosine > 0)
        rays = self._sampled.rays[above]
        blocked = self._occluder.blocks(np.broadcast_to(origin.astype(np.float32), rays.shape).copy(), rays)
        found = np.zeros(len(cosine))
        found[above[~blocked]] = cosine[above[~blocked]]
        return found, number, own

    def radiance(self, vertex, light, eye, brdfs):
        """Radiance (3,) of a vertex under the world's leaf light (leaves, 3)."""
        visible, number, own = self.visible_cos(vertex)
        body, shift = self._bodies[number], self._poses[number][:3, 3]
        toward = eye - body.vertices[own] - shift
        toward = toward / np.linalg.norm(toward)
        return radiance_of(visible, light, self._sampled.directions, body.normals[own], toward, brdfs[number])
