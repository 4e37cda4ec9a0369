"""Bodies by the radiance of their vertices, drawn by OpenGL, and which vertices a picture needs."""

import logging
from collections.abc import Sequence

import moderngl
import numpy as np
from numpy.typing import NDArray

from render.arrays import Float32, Float64, Int32, Rows
from render.camera import Camera, clip_from_world, depth_range, rows_from_gl
from render.context import open_context, renderer_name
from render.environment import Environment
from render.errors import GlUnavailableError
from render.mesh import Mesh
from render.on_card import Card, Target, by_columns
from render.picture import Picture
from render.programs import bind, set_uniform
from render.rays import toward_eye
from render.relit_bodies import Background, RelitBodies
from render.relit_reference import RelitReference

_log = logging.getLogger(__name__)


class RelitView:
    """Bodies drawn with the radiance of their vertices, and which vertices a picture needs. One thread's at a time.

    Vertices are numbered through all meshes, as in relighting; only front faces are drawn. Each pixel is the average of
    `supersampling` x `supersampling` samples, for which `visible` asks too: what it leaves out is in no sample.
    Raises SceneError for no mesh, GlUnavailableError where there is no OpenGL.
    """

    def __init__(self, meshes: Sequence[Mesh], supersampling: int = 2) -> None:
        self.bodies = RelitBodies.of(meshes)
        self._boxes = [_box(mesh.positions) for mesh in meshes]
        self._supersampling = supersampling
        self._answered: tuple[list[bytes], NDArray[np.int64]] | None = None
        self.context = open_context()
        self.name = renderer_name(self.context)
        with self.context:
            self._card = Card(self.context)
            self._positions = self.context.buffer(self.bodies.positions.astype(np.float32).tobytes())
            self._radiance = self.context.buffer(reserve=self._positions.size, dynamic=True)
            self._triangles = self.context.buffer(self.bodies.triangles.tobytes())
            self._panorama: tuple[Environment, moderngl.Texture] | None = None

    def visible(self, camera: Camera, poses: Sequence[Float64]) -> NDArray[np.int64]:
        """Ascending numbers of the vertices of all triangles that a picture from here shows.

        Where neither camera nor bodies have moved since the last question, the answer is the same array.
        """
        asked = [array.tobytes() for array in (np.array(camera.size), camera.matrix, camera.camera_from_world, *poses)]
        if self._answered is None or self._answered[0] != asked:
            triangles = self.triangles(camera.scaled(self._supersampling), poses)
            self._answered = asked, self.bodies.vertices_in(triangles)
            self._answered[1].setflags(write=False)
        return self._answered[1]

    def triangles(self, camera: Camera, poses: Sequence[Float64]) -> Int32:
        """Which triangle each pixel's middle sees, (h, w), numbered through all meshes; -1 where none."""
        poses = self.bodies.checked_poses(poses)
        with self.context:
            target = self._card.target("triangles", camera.size, (1,), whole_numbers=True)
            target.whole.use()
            target.whole.clear(depth=1.0)
            self.context.enable_only(moderngl.NOTHING)
            self._card.fill(self._card.program("screen.vert", "no_triangle.frag"))
            self._draw_bodies("triangle.frag", camera, poses)
            data = np.frombuffer(target.images[0].read(), np.int32)
        return rows_from_gl(data.reshape(camera.size[::-1])) - np.int32(1)

    def draw(
        self, camera: Camera, poses: Sequence[Float64], radiance: Float32, background: Background | None = None
    ) -> Picture:
        """The bodies in the radiance (all vertices, 3), linear and interpolated in space; of a vertex that is not
        `visible` any. Pixels that show nothing are 0 in radiance and coverage, unless there is a background.
        """
        poses, samples = self.bodies.checked_poses(poses), camera.scaled(self._supersampling)
        with self.context:
            self._radiance.write(self.bodies.checked_radiance(radiance).tobytes())
            target = self._card.target("relit", samples.size, (4,))
            target.whole.use()
            target.whole.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
            if background is not None:
                self._fill_with(background, samples)
            self._draw_bodies("relit.frag", samples, poses)
            data = np.frombuffer(self._averaged(target, camera.size).images[0].read(), np.float32)
        image = rows_from_gl(data.reshape(*camera.size[::-1], 4))
        return Picture(np.ascontiguousarray(image[:, :, :3]), np.ascontiguousarray(image[:, :, 3]))

    def release(self) -> None:
        """Give everything on the card back, the context last."""
        with self.context:
            for buffer in (self._positions, self._radiance, self._triangles):
                buffer.release()
            if self._panorama is not None:
                self._panorama[1].release()
            self._card.release()
        self.context.release()

    def _draw_bodies(self, shader: str, camera: Camera, poses: Sequence[Float64]) -> None:
        """All bodies that are before the camera, into the framebuffer in use."""
        boxes = [box @ pose[:3, :3].T + pose[:3, 3] for box, pose in zip(self._boxes, poses, strict=True)]
        ahead = [number for number, box in enumerate(boxes) if camera.in_camera(box)[:, 2].max() > 0.0]
        if not ahead:
            return
        clip = clip_from_world(camera, *depth_range(camera, np.concatenate([boxes[number] for number in ahead])))
        program = self._card.program("relit.vert", shader)
        content = [(self._positions, "3f", "position"), (self._radiance, "3f", "radiance")]
        vertex_array = self.context.vertex_array(program, content, self._triangles, skip_errors=True)
        self.context.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        for number in ahead:
            first, last = (int(each) for each in self.bodies.first_triangle[number : number + 2])
            set_uniform(program, "clip_from_body", by_columns(clip @ poses[number]))
            set_uniform(program, "first_triangle", first)
            vertex_array.render(vertices=3 * (last - first), first=3 * first)
        vertex_array.release()

    def _fill_with(self, background: Background, camera: Camera) -> None:
        program = self._card.program("screen.vert", "panorama.frag")
        bind(program, {"panorama": self._texture(background.environment)})
        set_uniform(program, "toward_from_window", by_columns(toward_eye(camera)))
        set_uniform(program, "light_from_world", by_columns(background.world_from_light.T))
        set_uniform(program, "azimuth_rad", background.environment.azimuth_rad)
        self.context.enable_only(moderngl.NOTHING)
        self._card.fill(program)

    def _averaged(self, samples: Target, size: tuple[int, int]) -> Target:
        """The samples of each pixel as their mean."""
        target = self._card.target("averaged", size, (4,))
        program = self._card.program("screen.vert", "averaged.frag")
        bind(program, {"image": samples.images[0]})
        set_uniform(program, "factor", self._supersampling)
        target.whole.use()
        self.context.enable_only(moderngl.NOTHING)
        self._card.fill(program)
        return target

    def _texture(self, environment: Environment) -> moderngl.Texture:
        """The environment on the card; the last one stays there."""
        if self._panorama is None or self._panorama[0] is not environment:
            if self._panorama is not None:
                self._panorama[1].release()
            height, width = environment.radiance.shape[:2]
            data = np.ascontiguousarray(environment.radiance, np.float32).tobytes()
            texture = self.context.texture((width, height), 3, data, dtype="f4")
            texture.repeat_x, texture.repeat_y = True, False
            self._panorama = environment, texture
        return self._panorama[1]


def open_relit_view(meshes: Sequence[Mesh]) -> RelitView | RelitReference:
    """By OpenGL, or, where none can be had, by the NumPy reference: a sample to a pixel, and a warning in the log."""
    try:
        return RelitView(meshes)
    except GlUnavailableError as error:
        _log.warning("%s. The NumPy reference draws instead.", error)
        return RelitReference(meshes, supersampling=1)


def _box(positions: Rows) -> Float64:
    """The corners (8, 3) of the positions' bounding box."""
    ends = np.stack([positions.min(axis=0), positions.max(axis=0)])
    return np.stack(np.meshgrid(*ends.T, indexing="ij"), axis=-1).reshape(-1, 3)
