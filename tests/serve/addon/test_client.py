"""The add-on's side of the conversation, with a real server of a small network."""

import threading

import numpy as np
import pytest
from addon_modules import addon
from networks import checkpoint_info, network
from serving import VIEW, scene, server

from rfpp.inference.renderer import Renderer

client, jobs, viewport = addon("client"), addon("jobs"), addon("viewport")
SIZED = client.View(tuple(map(tuple, VIEW["camera_to_world"])), tuple(VIEW["window"]), (24, 32), 2, 1)


class Gated(Renderer):
    """Renders when it is let, and remembers the sizes."""

    def __init__(self) -> None:
        super().__init__(network(), checkpoint_info())
        self.sizes, self.begun, self.goes_on = [], threading.Semaphore(0), threading.Semaphore(0)

    def render(self, scene, size, **values):
        self.sizes.append(size)
        self.begun.release()
        assert self.goes_on.acquire(timeout=60)
        return super().render(scene, size, **values)


def moved(view, x: float):
    rows = view.camera_to_world
    return client.View(((*rows[0][:3], x), *rows[1:]), view.window, view.size, 2, 1)


def test_pictures_come_and_scenes_are_sent_once(monkeypatch):
    with server() as served:
        asked = client.Server(served.url)
        assert asked.about()["network"] == "RenderFormer++"
        paths, post = [], client.Server._post
        monkeypatch.setattr(
            client.Server, "_post", lambda self, path, *rest: paths.append(path) or post(self, path, *rest)
        )
        glb = scene(intensity=0.0).glb()
        first = asked.picture(glb, SIZED)
        assert first.shape == (24, 32, 4) and first.dtype == np.float32
        assert "it has no light: three lights are added" in asked.notes_of(glb)
        assert not np.array_equal(asked.picture(glb, moved(SIZED, 0.5)), first)
        assert paths == ["/scenes", "/pictures", "/pictures"]
    with server() as another:  # that has never heard of it, as after a restart
        asked._place = another.server_address[:2]
        np.testing.assert_array_equal(asked.picture(glb, SIZED), first)
    assert paths[3:] == ["/pictures", "/scenes", "/pictures"]


def test_the_servers_errors_are_passed_on():
    with server(max_bytes=4096) as served:
        asked = client.Server(served.url)
        with pytest.raises(client.ServerError, match="is not a GLB file"):
            asked.picture(b"nonsense", SIZED)
        with pytest.raises(client.ServerError, match="20,000 bytes are more than the 4,096"):
            asked.picture(bytes(20_000), SIZED)


@pytest.mark.parametrize(
    "address",
    ["http://192.0.2.7:8700", "https://127.0.0.1:8700", "http://example.org", "127.0.0.1:8700", "", "http://[::1", "ftp://localhost"],
)  # fmt: skip
def test_only_addresses_of_this_machine_are_taken(address):
    with pytest.raises(client.ServerError, match="no address on this machine"):
        client.Server(address)


def test_where_no_server_is_it_says_how_to_start_one():
    with pytest.raises(client.ServerError, match=r"No server at http://127\.0\.0\.1:9: start one with `rfpp serve`"):
        client.Server("http://127.0.0.1:9").about()


def test_a_cancelled_job_ends_while_the_server_is_at_it():
    renderer = Gated()
    with server(renderer) as served:
        job = jobs.Job(client.Server(served.url), scene().glb(), SIZED)
        assert renderer.begun.acquire(timeout=60)
        assert not job.wait(0.0)
        job.cancel()
        assert job.wait(0.0) and job.picture is None and job.error == ""
        renderer.goes_on.release()
        other = jobs.Job(client.Server(served.url), scene().glb(), SIZED)
        renderer.goes_on.release()
        assert other.wait(60) and other.picture is not None


def test_a_view_that_changes_is_small_and_what_is_outdated_is_never_asked_for():
    renderer, view = Gated(), client.View(SIZED.camera_to_world, SIZED.window, (192, 256), 2, 1)
    with server(renderer) as served:
        newest, glb = jobs.Newest(client.Server(served.url)), scene().glb()
        newest.want(glb, view)
        assert renderer.begun.acquire(timeout=60)
        for x in (0.1, 0.2, 0.3):  # meanwhile
            newest.want(glb, moved(view, x))
        for _ in range(3):
            renderer.goes_on.release()
        while newest.is_busy:
            threading.Event().wait(0.01)
        expected = client.Server(served.url)
        renderer.goes_on.release()
        whole = expected.picture(glb, moved(view, 0.3))
    assert len(renderer.sizes) == 4  # the first view small, the last one small and whole, and this one
    assert renderer.sizes[0] == (48, 64) and renderer.sizes[2] == (192, 256)
    np.testing.assert_array_equal(newest.picture, whole)
    assert newest.error == ""


def test_the_small_picture_of_a_viewport_of_any_shape_has_square_pixels():
    """The server refuses others: 64 x 42 pixels of a window that is one of 256 x 170."""
    window = viewport.square_pixels((-0.72, 0.72, -0.47, 0.47), (170, 256))
    with server() as served:
        newest = jobs.Newest(client.Server(served.url))
        newest.want(scene().glb(), client.View(SIZED.camera_to_world, window, (170, 256), 2, 1))
        while newest.is_busy:
            threading.Event().wait(0.01)
    assert newest.error == "" and newest.picture.shape == (170, 256, 4)


def test_a_viewport_without_a_server_says_so_and_asks_again_when_something_changes():
    newest = jobs.Newest(client.Server("http://127.0.0.1:9"))
    newest.want(b"scene", SIZED)
    while newest.is_busy:
        threading.Event().wait(0.01)
    assert "No server" in newest.error and newest.picture is None
    with server() as served:
        newest.server._place = served.server_address[:2]
        newest.want(scene().glb(), SIZED)
        while newest.is_busy:
            threading.Event().wait(0.01)
    assert newest.error == "" and newest.picture.shape == (24, 32, 4)
