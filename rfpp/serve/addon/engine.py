"""The render engine: F12, and the viewport's render mode."""

from __future__ import annotations

import contextlib
import time

import bpy
import numpy as np

from .client import Server, ServerError, View
from .jobs import Job, Newest
from .scene_export import exported
from .settings_panels import ENGINE, address
from .viewport import NoView, Window, camera_window, part_of, rows_of, shrunk, square_pixels, window_of

#: Seconds between looks at whether a picture has come, or nobody wants it any longer.
_GLANCE = 0.05


class RfppEngine(bpy.types.RenderEngine):
    """Exports the evaluated scene, sends it, shows what comes back."""

    bl_idname = ENGINE
    bl_label = "rfpp"
    bl_use_preview = False
    bl_use_eevee_viewport = True  # in material preview
    bl_use_shading_nodes_custom = False

    _viewport: Viewport | None = None

    def render(self, depsgraph) -> None:
        """F12, of one view layer. In the GUI this is another thread than Blender's own."""
        scene = depsgraph.scene_eval
        try:
            if scene.camera is None:
                raise NoView("The scene has no camera: add one")
            box, window = _final(self, depsgraph)
            content, left_out = exported(depsgraph, {})
            for line in left_out:
                self.report({"WARNING"}, line)
            server = Server(address())
            view = View(
                rows_of(_pose(scene.camera.evaluated_get(depsgraph))),
                window,
                (box[3], box[2]),
                depsgraph.scene.rfpp.light_samples,
                depsgraph.scene.rfpp.supersampling,
                scene.render.film_transparent,
            )
            picture = self._finished(Job(server, content, view))
        except (NoView, ServerError) as error:
            self.report({"ERROR"}, str(error))
            return
        if picture is None:
            return
        for note in server.notes_of(content):
            self.report({"INFO"}, note)
        result = self.begin_result(0, 0, box[2], box[3], layer=depsgraph.view_layer_eval.name)
        combined = result.layers[0].passes["Combined"]
        combined.rect.foreach_set(np.ascontiguousarray(picture[::-1]).reshape(-1))
        self.end_result(result)

    def _finished(self, job: Job) -> np.ndarray | None:
        """None if it was cancelled. Raises ServerError."""
        begin, said = time.monotonic(), 0
        while not job.wait(_GLANCE):
            if self.test_break():
                job.cancel()
                return None
            if (seconds := int(time.monotonic() - begin)) > said:
                said = seconds
                self.update_stats("", f"rfpp: rendering for {said} s")
        self.update_progress(1.0)
        if job.error:
            raise ServerError(job.error)
        return job.picture

    def view_update(self, context, depsgraph) -> None:
        """The scene, or the viewport, has changed."""
        if self._viewport is None:
            self._viewport = Viewport()
        self._viewport.update(depsgraph)

    def view_draw(self, context, depsgraph) -> None:
        """Draw what there is."""
        if self._viewport is None:
            self._viewport = Viewport()
            self._viewport.update(depsgraph)
        said = self._viewport.want(context, depsgraph)
        self.update_stats("rfpp", said)
        if self._viewport.picture is not None:
            self.bind_display_space_shader(depsgraph.scene)
            self._viewport.draw(context.region)
            self.unbind_display_space_shader()
        if self._viewport.is_busy:
            bpy.app.timers.register(self._drawn_again, first_interval=_GLANCE)

    def _drawn_again(self) -> None:
        with contextlib.suppress(ReferenceError):  # the viewport is gone
            self.tag_redraw()


class Viewport:
    """What one viewport shows."""

    def __init__(self) -> None:
        self._newest: Newest | None = None
        self._scene, self._left_out = b"", 0
        self._pictures: dict[str, bytes] = {}
        self._drawn: tuple[np.ndarray, object] | None = None  # a picture, and its texture

    @property
    def picture(self) -> np.ndarray | None:
        return self._newest.picture if self._newest else None

    @property
    def is_busy(self) -> bool:
        return bool(self._newest and self._newest.is_busy)

    def update(self, depsgraph) -> None:
        """Export the scene again."""
        for change in depsgraph.updates:
            if isinstance(change.id, bpy.types.Image):
                self._pictures.pop(change.id.name_full, None)
        content, left_out = exported(depsgraph, self._pictures)
        self._left_out = len(left_out)
        if content != self._scene:
            self._scene = content

    def draw(self, region) -> None:
        """The newest picture, enlarged to the region."""
        import gpu
        from gpu_extras.presets import draw_texture_2d

        picture = self.picture
        if self._drawn is None or self._drawn[0] is not picture:
            self._drawn = picture, _texture(picture)
        gpu.state.blend_set("ALPHA_PREMULT")
        draw_texture_2d(self._drawn[1], (0, 0), region.width, region.height)
        gpu.state.blend_set("NONE")

    def want(self, context, depsgraph) -> str:
        """Ask for the picture of a 3D viewport as it is now; returns a line about it."""
        region, settings = context.region_data, depsgraph.scene.rfpp
        if not region.is_perspective:
            return "Orthographic views cannot be shown: press Numpad 5"
        size = (context.region.height, context.region.width)
        small = shrunk(size, settings.viewport_pixels)
        view = View(
            rows_of(region.view_matrix.inverted()),
            square_pixels(window_of(region.window_matrix), small),
            small,
            settings.light_samples,
            settings.supersampling,
        )
        try:
            if self._newest is None or self._newest.server.address != address():
                self._newest = Newest(Server(address()))
        except ServerError as error:
            return str(error)
        self._newest.want(self._scene, view)
        if self._newest.error:
            return self._newest.error
        if self._newest.picture is None:
            return "The first picture is on its way"
        things = f"{self._left_out} thing{'s' * (self._left_out != 1)}"
        return f"{things} left out: F12 says which" if self._left_out else ""


def _texture(picture: np.ndarray):
    """On the GPU, row 0 at the bottom."""
    import gpu  # there is none without a display

    height, width, _ = picture.shape
    pixels = gpu.types.Buffer("FLOAT", height * width * 4, np.ascontiguousarray(picture[::-1]).reshape(-1))
    return gpu.types.GPUTexture((width, height), format="RGBA16F", data=pixels)


def _final(engine: RfppEngine, depsgraph) -> tuple[tuple[int, int, int, int], Window]:
    """X, y, width and height of what is rendered of the picture, and its window."""
    scene = depsgraph.scene_eval
    render, camera = scene.render, scene.camera.evaluated_get(depsgraph)
    size = tuple(int(side * render.resolution_percentage / 100) for side in (render.resolution_y, render.resolution_x))
    window = camera_window(camera, depsgraph, size)
    if render.pixel_aspect_x != render.pixel_aspect_y:
        engine.report({"WARNING"}, "Pixels are rendered square")
    window = square_pixels(window, size)
    box = (0, 0, size[1], size[0])
    if render.use_border:
        x, right = (int(side * size[1]) for side in (render.border_min_x, render.border_max_x))
        y, top = (int(side * size[0]) for side in (render.border_min_y, render.border_max_y))
        box = (x, y, max(right - x, 1), max(top - y, 1))
    return box, part_of(window, size, box)


def _pose(camera):
    """Without the scale of a camera, which Blender does not heed."""
    return camera.matrix_world.normalized()


def register() -> None:
    bpy.utils.register_class(RfppEngine)


def unregister() -> None:
    bpy.utils.unregister_class(RfppEngine)
