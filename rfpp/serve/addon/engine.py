"""The render engine: F12, and the viewport's render mode."""

from __future__ import annotations

import contextlib
import time
from concurrent.futures import ThreadPoolExecutor

import bpy
import numpy as np

from .client import Cancelled, Server, ServerError, View
from .scene_export import exported
from .settings_panels import ENGINE, address
from .viewport import Viewport
from .windows import NoView, Window, camera_window, part_of, rows_of, square_pixels

#: Seconds between checks for a finished picture or a cancelled render.
_INTERVAL = 0.05


class RfppEngine(bpy.types.RenderEngine):
    """Render engine that exports the evaluated scene, sends it and shows the picture."""

    bl_idname = ENGINE
    bl_label = "rfpp"
    bl_use_preview = False
    bl_use_eevee_viewport = True  # in material preview
    bl_use_shading_nodes_custom = False

    _viewport: Viewport | None = None

    def render(self, depsgraph) -> None:
        """Render one view layer for F12, outside of Blender's main thread."""
        scene = depsgraph.scene_eval
        try:
            if scene.camera is None:
                raise NoView("The scene has no camera: add one")
            camera = scene.camera.evaluated_get(depsgraph)
            (_, _, width, height), window = self._region(camera, depsgraph)
            content, warnings = exported(depsgraph, {})
            for line in warnings:
                self.report({"WARNING"}, line)
            server, settings = Server(address()), depsgraph.scene.rfpp
            pose = rows_of(camera.matrix_world.normalized())  # Blender ignores a camera's scale
            sampling = settings.light_samples, settings.supersampling
            view = View(pose, window, (height, width), *sampling, scene.render.film_transparent)
            picture = self._rendered(server, content, view)
        except (NoView, ServerError) as error:
            self.report({"ERROR"}, str(error))
            return
        if picture is None:
            return
        for note in server.notes(content):
            self.report({"INFO"}, note)
        result = self.begin_result(0, 0, width, height, layer=depsgraph.view_layer_eval.name)
        combined = result.layers[0].passes["Combined"]
        combined.rect.foreach_set(np.ascontiguousarray(picture[::-1]).reshape(-1))
        self.end_result(result)

    def _region(self, camera, depsgraph) -> tuple[tuple[int, int, int, int], Window]:
        """Return x, y, width and height of the rendered region, and its window."""
        render = depsgraph.scene_eval.render
        share = render.resolution_percentage / 100
        size = height, width = int(render.resolution_y * share), int(render.resolution_x * share)
        if render.pixel_aspect_x != render.pixel_aspect_y:
            self.report({"WARNING"}, "Pixels are rendered square")
        window = square_pixels(camera_window(camera, depsgraph, size), size)
        box = (0, 0, width, height)
        if render.use_border:
            x, right = (int(side * width) for side in (render.border_min_x, render.border_max_x))
            y, top = (int(side * height) for side in (render.border_min_y, render.border_max_y))
            box = (x, y, max(right - x, 1), max(top - y, 1))
        return box, part_of(window, size, box)

    def _rendered(self, server: Server, content: bytes, view: View) -> np.ndarray | None:
        """Return the picture, or None if the user cancels. Raises ServerError."""
        begin, connection = time.monotonic(), server.connect()
        with ThreadPoolExecutor(1) as executor:
            future = executor.submit(server.picture, content, view, connection)
            while True:
                try:
                    return future.result(_INTERVAL)
                except TimeoutError:
                    self.update_stats("", f"rfpp: rendering for {time.monotonic() - begin:.0f} s")
                except Cancelled:
                    return None
                if self.test_break():
                    connection.cancel()

    def view_update(self, context, depsgraph) -> None:
        """Export the scene for the viewport after a change."""
        if self._viewport is None:
            self._viewport = Viewport()
        self._viewport.update(depsgraph)

    def view_draw(self, context, depsgraph) -> None:
        """Draw the viewport."""
        if self._viewport is None:
            self.view_update(context, depsgraph)
        self.update_stats("rfpp", self._viewport.want(context, depsgraph))
        if self._viewport.picture is not None:
            self.bind_display_space_shader(depsgraph.scene)
            self._viewport.draw(context.region)
            self.unbind_display_space_shader()
        if self._viewport.is_busy:
            bpy.app.timers.register(self._redraw, first_interval=_INTERVAL)

    def _redraw(self) -> None:
        with contextlib.suppress(ReferenceError):  # the viewport was closed
            self.tag_redraw()


def register() -> None:
    """Register the classes with Blender."""
    bpy.utils.register_class(RfppEngine)


def unregister() -> None:
    """Unregister the classes."""
    bpy.utils.unregister_class(RfppEngine)
