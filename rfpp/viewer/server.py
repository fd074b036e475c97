"""The viewer's web server: each visitor has a session and controls; they share renderer and path tracer."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from contextlib import redirect_stdout
from functools import partial
from io import StringIO

import viser

from rfpp.errors import SceneError, UserError
from rfpp.inference.renderer import Renderer
from rfpp.scene.packed import PackedScene
from rfpp.scene.spec import Camera, Scene
from rfpp.viewer.controls import ObjectControls, ToneMaps, add_reference, add_saving, add_view
from rfpp.viewer.layers import layers_of
from rfpp.viewer.reference import PathTracer
from rfpp.viewer.session import Drawn, Session, View
from rfpp.viewer.viser_cameras import aspect_of, camera_of, cameras_of, stand_at

#: Visitors turn about this point, the middle of every scene.
CENTRE = (0.0, 0.0, 0.0)
_JPEG_QUALITY = 90


class Viewer:
    """Serves a scene until `close`. Use as a context manager.

    Args:
        renderer: of a trained network.
        scene: with a camera at least. A packed one, which holds no objects, is looked at but not edited.
        tone_maps: to choose from, the first to begin with.
        tracer: of references.
        host, port: where to listen; the next free port is taken.
        longer_side: pixels of an image at rest.
        moving_seconds: an image in motion may take.

    Raises:
        SceneError: there is no camera.
        UserError: host or port is none of this machine's.
    """

    def __init__(
        self,
        renderer: Renderer,
        scene: Scene | PackedScene,
        tone_maps: ToneMaps,
        tracer: PathTracer,
        host: str,
        port: int,
        longer_side: int,
        moving_seconds: float | int,
    ):
        cameras = cameras_of(scene)
        if not cameras:
            raise SceneError(f"scene '{scene.name}' has no camera: add one to its `cameras`")
        self._renderer, self._scene, self._cameras, self._tracer = renderer, scene, cameras, tracer
        self._tone_maps, self._longer_side, self._moving_seconds = tone_maps, longer_side, moving_seconds
        self._turn = threading.Lock()
        self._sessions: dict[int, Session] = {}
        _require_address(host, port)
        with redirect_stdout(StringIO()):  # viser prints a box
            self._server = viser.ViserServer(host=host, port=port, label=f"rfpp: {scene.name}", verbose=False)
        self._server.scene.set_up_direction("+z")
        self._server.on_client_connect(self._welcome)
        self._server.on_client_disconnect(self._bid_farewell)

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{self._server.get_host()}:{self._server.get_port()}"

    def close(self) -> None:
        """Disconnect all visitors and stop the server."""
        for session in self._sessions.values():
            session.close()
        self._tracer.close()
        self._server.stop()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _welcome(self, client: viser.ClientHandle) -> None:
        stand_at(client, self._cameras[0], CENTRE)
        complain = partial(client.add_notification, "That cannot be rendered", color="red", auto_close_seconds=8.0)
        layers = layers_of(self._renderer)
        first_tone_map = next(iter(self._tone_maps.values()))
        view = View(
            scene=self._scene,
            camera=self._cameras[0],
            aspect=aspect_of(client),
            layer=next(iter(layers.values())),
            tone_map=first_tone_map(stops=0.0),
            longer_side=self._longer_side,
        )
        status = client.gui.add_markdown("")
        page = _Page(client, status)
        session = Session(self._renderer, self._turn, view, page.show, complain, self._moving_seconds)
        self._sessions[client.client_id] = session
        add_view(client.gui, session, layers, self._tone_maps, self._cameras, self._go_to(client))
        if isinstance(self._scene, Scene):
            ObjectControls(client, session, self._scene, complain)
        page.tell = add_reference(client.gui, session, self._tracer, complain)
        add_saving(client.gui, client, session, lambda: page.newest)
        client.camera.on_update(lambda _: session.change(camera=camera_of(client), aspect=aspect_of(client)))

    def _go_to(self, client: viser.ClientHandle) -> Callable[[Camera], None]:
        return lambda camera: stand_at(client, camera, CENTRE)

    def _bid_farewell(self, client: viser.ClientHandle) -> None:
        if session := self._sessions.pop(client.client_id, None):
            session.close()


def _require_address(host: str, port: int) -> None:
    """Raises UserError for an address that cannot be bound; viser would retry forever."""
    if not 0 <= port <= 65535:
        raise UserError(f"port={port}: is none: choose one from 1024 to 65535")
    try:
        with socket.create_server((host, 0)):
            pass
    except OSError as error:
        raise UserError(f"host={host}: is no address of this machine ({error.strerror}): leave it away") from None


class _Page:
    """A visitor's page."""

    def __init__(self, client: viser.ClientHandle, status: viser.GuiMarkdownHandle):
        self._client, self._status = client, status
        self.tell: Callable[[Drawn], None] = lambda drawn: None
        self.newest: Drawn | None = None

    def show(self, drawn: Drawn) -> None:
        self.newest = drawn
        self._client.scene.set_background_image(drawn.picture, format="jpeg", jpeg_quality=_JPEG_QUALITY)
        height, width = drawn.rendered
        self._status.content = f"{width} × {height} in {1000 * drawn.seconds:.0f} ms"
        self.tell(drawn)
