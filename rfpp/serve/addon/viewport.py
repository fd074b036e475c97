"""The picture of one 3D viewport."""

from __future__ import annotations

import bpy
import numpy as np

from .client import Server, ServerError, View
from .newest_view import Newest
from .scene_export import exported
from .settings_panels import address
from .windows import rows_of, shrunk, square_pixels, window_of


class Viewport:
    """Viewport drawing: exports the scene, requests pictures of the view and draws them."""

    def __init__(self) -> None:
        self._newest: Newest | None = None
        self._scene, self._omitted = b"", 0
        self._textures: dict[str, bytes] = {}
        self._drawn: tuple[np.ndarray, object] | None = None  # a picture, and its texture on the GPU

    @property
    def picture(self) -> np.ndarray | None:
        """Newest picture [h, w, 4]."""
        return self._newest.picture if self._newest else None

    @property
    def is_busy(self) -> bool:
        """True if another picture will follow."""
        return bool(self._newest and self._newest.is_busy)

    def update(self, depsgraph) -> None:
        """Export the scene again."""
        for change in depsgraph.updates:
            if isinstance(change.id, bpy.types.Image):
                self._textures.pop(change.id.name_full, None)
        content, lines = exported(depsgraph, self._textures)
        self._omitted = len(lines)
        if content != self._scene:
            self._scene = content

    def want(self, context, depsgraph) -> str:
        """Request a picture of the current view, and return a line of status."""
        region, settings = context.region_data, depsgraph.scene.rfpp
        if not region.is_perspective:
            return "Orthographic views are not supported: press Numpad 5"
        size = shrunk((context.region.height, context.region.width), settings.viewport_pixels)
        window = square_pixels(window_of(region.window_matrix), size)
        pose = rows_of(region.view_matrix.inverted())
        try:
            if self._newest is None or self._newest.server.address != address():
                self._newest = Newest(Server(address()))
        except ServerError as error:
            return str(error)
        self._newest.want(self._scene, View(pose, window, size, settings.light_samples, settings.supersampling))
        if self._newest.error:
            return self._newest.error
        if self._newest.picture is None:
            return "Rendering the first picture"
        return f"{self._omitted} warnings: press F12 to list them" if self._omitted else ""

    def draw(self, region) -> None:
        """Draw the newest picture, enlarged to the region."""
        import gpu
        from gpu_extras.presets import draw_texture_2d

        picture = self.picture
        if self._drawn is None or self._drawn[0] is not picture:
            self._drawn = picture, _texture(picture)
        gpu.state.blend_set("ALPHA_PREMULT")
        draw_texture_2d(self._drawn[1], (0, 0), region.width, region.height)
        gpu.state.blend_set("NONE")


def _texture(picture: np.ndarray):
    import gpu  # needs a display

    height, width, _ = picture.shape
    pixels = gpu.types.Buffer("FLOAT", height * width * 4, np.ascontiguousarray(picture[::-1]).reshape(-1))
    return gpu.types.GPUTexture((width, height), format="RGBA16F", data=pixels)
