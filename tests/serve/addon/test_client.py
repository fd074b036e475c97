"""The add-on's client, with a real server of a small network."""

import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from addon_modules import addon
from networks import checkpoint_info, network
from serving import VIEW, scene, server

from rfpp.inference.renderer import Renderer

client, newest_view, windows = addon("client"), addon("newest_view"), addon("windows")
SMALL_VIEW = client.View(tuple(map(tuple, VIEW["camera_to_world"])), tuple(VIEW["window"]), (24, 32), 2, 1)
NOWHERE = "http://127.0.0.1:9"  # the discard port, on which nothing listens


class Gated(Renderer):
    """Renders when allowed, and records the sizes."""

    def __init__(self) -> None:
        super().__init__(network(), checkpoint_info())
        self.sizes, self.begun, self.allowed = [], threading.Semaphore(0), threading.Semaphore(0)

    def render(self, scene, size, **values):
        self.sizes.append(size)
        self.begun.release()
        assert self.allowed.acquire(timeout=60)
        return super().render(scene, size, **values)


def moved(view, x: float):
    rows = view.camera_to_world
    return client.View(((*rows[0][:3], x), *rows[1:]), view.window, view.size, 2, 1)


def finished(newest):
    while newest.is_busy:
        threading.Event().wait(0.01)
    return newest


def test_scenes_are_sent_once_and_again_after_a_restart(monkeypatch):
    paths, post = [], client.Connection.post
    monkeypatch.setattr(client.Connection, "post", lambda it, path, body: paths.append(path) or post(it, path, body))
    with server() as served:
        used = client.Server(served.url)
        glb = scene(intensity=0.0).glb()
        first = used.picture(glb, SMALL_VIEW)
        assert first.shape == (24, 32, 4) and first.dtype == np.float32
        assert any("no light" in note for note in used.notes(glb))
        assert not np.array_equal(used.picture(glb, moved(SMALL_VIEW, 0.5)), first)
    assert paths == ["/scenes", "/pictures", "/pictures"]
    with server() as restarted:
        used._port = restarted.address[1]
        np.testing.assert_array_equal(used.picture(glb, SMALL_VIEW), first)
    assert paths[3:] == ["/pictures", "/scenes", "/pictures"]


def test_errors_of_the_server_are_passed_on():
    with server(max_bytes=4096) as served:
        for content, error in ((b"nonsense", "is not a GLB file"), (bytes(20_000), "more than 4,096 bytes")):
            with pytest.raises(client.ServerError, match=error):
                client.Server(served.url).picture(content, SMALL_VIEW)
    with pytest.raises(client.ServerError, match=f"No server at {NOWHERE}: start one with `rfpp serve`"):
        client.Server(NOWHERE).picture(b"scene", SMALL_VIEW)


@pytest.mark.parametrize(
    "address",
    ["http://192.0.2.7:8700", "https://127.0.0.1:8700", "127.0.0.1:8700", "", "http://[::1", "ftp://localhost"],
)
def test_addresses_of_other_machines_are_refused(address):
    with pytest.raises(client.ServerError, match="not an address of this machine"):
        client.Server(address)


def test_a_picture_is_cancelled_while_the_server_renders():
    renderer = Gated()
    with server(renderer) as served:
        used, connections = client.Server(served.url), []
        with ThreadPoolExecutor(1) as executor:
            for _ in range(2):
                connections.append(used.connect())
                future = executor.submit(used.picture, scene().glb(), SMALL_VIEW, connections[-1])
                assert renderer.begun.acquire(timeout=60)
                connections[-1].cancel()
                with pytest.raises(client.Cancelled):
                    future.result(timeout=60)
                renderer.allowed.release()
        early = used.connect()
        early.cancel()
        with pytest.raises(client.Cancelled):
            used.picture(scene().glb(), SMALL_VIEW, early)
        renderer.allowed.release()
        assert used.picture(scene().glb(), SMALL_VIEW).shape == (24, 32, 4)


def test_a_changing_view_is_small_and_outdated_views_are_skipped():
    renderer, view = Gated(), client.View(SMALL_VIEW.camera_to_world, SMALL_VIEW.window, (192, 256), 2, 1)
    with server(renderer) as served:
        newest, glb = newest_view.Newest(client.Server(served.url)), scene().glb()
        newest.want(glb, view)
        assert renderer.begun.acquire(timeout=60)
        for x in (0.1, 0.2, 0.3):  # meanwhile
            newest.want(glb, moved(view, x))
        renderer.allowed.release(4)
        finished(newest)
        whole = client.Server(served.url).picture(glb, moved(view, 0.3))
    assert renderer.sizes[0] == (48, 64) and len(renderer.sizes) == 4  # small, small, in full; and `whole`
    assert renderer.sizes[2:] == [(192, 256)] * 2
    np.testing.assert_array_equal(newest.picture, whole)
    assert newest.error == ""


def test_small_pictures_of_any_shape_have_square_pixels():
    """64 × 42 pixels of a window for 256 × 170: the server refuses pixels that are not square."""
    window = windows.square_pixels((-0.72, 0.72, -0.47, 0.47), (170, 256))
    with server() as served:
        newest = newest_view.Newest(client.Server(served.url))
        newest.want(scene().glb(), client.View(SMALL_VIEW.camera_to_world, window, (170, 256), 2, 1))
        assert finished(newest).error == "" and newest.picture.shape == (170, 256, 4)


def test_a_viewport_without_a_server_retries_after_the_next_change():
    newest = newest_view.Newest(client.Server(NOWHERE))
    newest.want(b"scene", SMALL_VIEW)
    assert "No server" in finished(newest).error and newest.picture is None
    with server() as served:
        newest.server._port = served.address[1]
        newest.want(scene().glb(), SMALL_VIEW)
        assert finished(newest).error == "" and newest.picture.shape == (24, 32, 4)
