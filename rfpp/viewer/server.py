"""The viewer's web server: each visitor has a session and controls; they share the renderer."""

from __future__ import annotations

import socket
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import redirect_stdout
from functools import partial
from io import StringIO

import viser

from rfpp.errors import SceneError, UserError
from rfpp.inference.renderer import Renderer
from rfpp.reference.cycles import CyclesSettings
from rfpp.scene.packed import PackedScene
from rfpp.scene.spec import Scene
from rfpp.viewer.controls import ObjectControls, ToneMaps, add_reference, add_saving, add_view
from rfpp.viewer.guard import guarded
from rfpp.viewer.layers import layers_of
from rfpp.viewer.pacing import Pacing
from rfpp.viewer.session import Drawn, Session, View
from rfpp.viewer.viser_cameras import aspect_of, camera_of, cameras_of, move_to

_JPEG_QUALITY = 90


class Viewer:
    """Web page of a scene; use as a context manager.

    Args:
        scene: Scene with at least one camera; a packed one cannot be edited.
        tone_maps: Tone maps by name; the first is the default.
        port: Port to listen on, or the next free one.
        longer_side: Pixels of an image at rest.
        moving_seconds: Target time of an image in motion.

    Raises:
        UserError: If the address is not one of this machine.
    """

    def __init__(
        self,
        renderer: Renderer,
        scene: Scene | PackedScene,
        tone_maps: ToneMaps,
        cycles: CyclesSettings,
        host: str,
        port: int,
        longer_side: int,
        moving_seconds: float | int,
    ):
        if not (cameras := cameras_of(scene)):
            raise SceneError(f"scene '{scene.name}' has no camera: add one to its `cameras`")
        self._renderer, self._scene, self._cameras, self._cycles = renderer, scene, cameras, cycles
        self._tone_maps, self._longer_side, self._moving_seconds = tone_maps, longer_side, moving_seconds
        self._lock, self._executor = threading.Lock(), ThreadPoolExecutor(1, "path tracing")
        self._sessions: dict[int, Session] = {}
        _require_address(host, port)
        with redirect_stdout(StringIO()), guarded():  # viser prints a banner
            self._server = viser.ViserServer(host=host, port=port, label=f"rfpp: {scene.name}", verbose=False)
        self._server.scene.set_up_direction("+z")
        self._server.on_client_connect(self._open_session)
        self._server.on_client_disconnect(self._close_session)

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{self._server.get_host()}:{self._server.get_port()}"

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        for session in self._sessions.values():
            session.close()
        self._executor.shutdown(wait=False, cancel_futures=True)
        self._server.stop()

    def _open_session(self, client: viser.ClientHandle) -> None:
        camera, layers = self._cameras[0], layers_of(self._renderer)
        move_to(client, camera)
        report = partial(client.add_notification, "This cannot be rendered", color="red", auto_close_seconds=8.0)
        layer, tone_map = next(iter(layers.values())), next(iter(self._tone_maps.values()))
        view = View(self._scene, camera, aspect_of(client), layer, tone_map(stops=0.0), self._longer_side)
        status = client.gui.add_markdown("")

        def show(drawn: Drawn) -> None:
            client.scene.set_background_image(drawn.picture, format="jpeg", jpeg_quality=_JPEG_QUALITY)
            height, width = drawn.rendered
            status.content = f"{width} × {height} in {1000 * drawn.seconds:.0f} ms"

        pacing = Pacing(self._renderer.engine.patch_size, self._moving_seconds)
        session = Session(view, pacing, self._lock, report)
        session.on_draw(show)
        self._sessions[client.client_id] = session
        add_view(client, session, layers, self._tone_maps, self._cameras)
        if isinstance(self._scene, Scene):
            ObjectControls(client, session, self._scene, report)
        add_reference(client.gui, session, self._cycles, self._executor, report)
        add_saving(client, session)
        client.camera.on_update(lambda _: session.change(camera=camera_of(client), aspect=aspect_of(client)))
        session.start()

    def _close_session(self, client: viser.ClientHandle) -> None:
        if session := self._sessions.pop(client.client_id, None):
            session.close()


def _require_address(host: str, port: int) -> None:
    """Raise UserError for an address that cannot be bound; viser would retry forever."""
    if not 0 <= port <= 65535:
        raise UserError(f"port={port}: invalid port: choose one from 1024 to 65535")
    try:
        with socket.create_server((host, 0)):
            pass
    except OSError as error:
        raise UserError(f"host={host}: not an address of this machine ({error.strerror}): omit it") from None
