"""Requests to the server for Blender: pictures, errors in one line, and refused clients."""

import json
import socket
import threading
import warnings

import numpy as np
import pytest
from gltf_files import GltfBuilder
from networks import checkpoint_info, network
from serving import VIEW, ask, scene, send, server

from rfpp.errors import UserError
from rfpp.inference.renderer import Renderer
from rfpp.scene.io.loading import load_scene
from rfpp.scene.spec import Camera
from rfpp.serve.server import Server


@pytest.fixture(scope="module")
def served():
    with server() as started:
        yield started


def picture(served, name: str, **view: object) -> np.ndarray:
    status, content = ask(served, "/pictures", VIEW | {"scene": name} | view)
    assert status == 200, content
    return np.frombuffer(content, "<f4").reshape(*(VIEW | view)["size"], 4)


def test_pictures_equal_those_of_the_same_file(served, tmp_path):
    rendered = picture(served, send(served, scene().glb()), size=[24, 32])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        loaded = load_scene(scene().write(tmp_path), backdrop="none")
    # the four wide floor is scaled by 1/4, and the square's top is at 1
    fov = 2 * np.degrees(np.arctan(0.4))
    camera = Camera(position=(0, -1.5, 0.25), look_at=(0, -1.5 + 0.98, 0.25 - 0.2), up=(0, 0.2, 0.98), fov=fov)
    [expected] = Renderer(network(), checkpoint_info()).render(loaded, (24, 32), [camera], 2, 1)
    assert expected.std() > 0.01
    np.testing.assert_allclose(rendered[..., :3], expected, atol=1e-3 * expected.max())
    assert (rendered[..., 3] == 1).all()


def test_scenes_are_cached_and_edits_encode_what_changed():
    renderer = Renderer(network(), checkpoint_info())
    with server(renderer) as served:
        name = send(served, scene().glb())
        first, encoded = picture(served, name), renderer.engine.objects.encoded
        shifted = [[1, 0, 0, 0.5], *VIEW["camera_to_world"][1:]]
        assert not np.array_equal(first, picture(served, name, camera_to_world=shifted))
        assert send(served, scene().glb()) == name
        assert renderer.engine.objects.encoded == encoded
        picture(served, send(served, scene(x=0.5).glb()))
        assert renderer.engine.objects.encoded == encoded + 1


def test_alpha_is_the_coverage_by_surfaces(served):
    name = send(served, scene().glb())
    alpha = picture(served, name, transparent=True)[..., 3]
    assert alpha[[0, -1]].max() == 0 and alpha[15, 8:24].min() == 1  # above, before and on the floor
    fine = picture(served, name, transparent=True, supersampling=4)[..., 3]
    assert ((fine > 0) & (fine < 1)).any()


@pytest.mark.parametrize(
    ("change", "status", "why"),
    [
        ({"scene": "0" * 32}, 404, "send it first"),
        ({"size": [24]}, 422, "picture.size"),
        ({"size": [24, 10**6]}, 422, "picture.size.1"),
        ({"size": [16384, 16384], "window": [-0.4, 0.4, -0.4, 0.4], "supersampling": 8}, 422, "of memory"),
        ({"light_samples": 0}, 422, "picture.light_samples"),
        ({"window": [float("nan"), 0.4, -0.3, 0.3]}, 422, "picture.window.0"),
        ({"window": [0.4, -0.4, -0.3, 0.3]}, 422, "is empty"),
        ({"camera_to_world": [[0, 0, 0, 0]] * 3}, 422, "no direction"),
        ({"camera_to_world": [[1, 0, 0, 1e300]] * 3}, 422, "picture.camera_to_world"),
        ({"surprise": 1}, 422, "unknown key"),
    ],
)
def test_an_invalid_request_is_one_line(served, change, status, why):
    answer = ask(served, "/pictures", VIEW | {"scene": send(served, scene().glb())} | change)
    error = json.loads(answer[1])["error"]
    assert answer[0] == status and why in error and "\n" not in error


@pytest.mark.parametrize("body", [b"", b"{", b"[]", b"\xff", b'{"a":' * 5_000, b'{"size":' + b"9" * 5000 + b"}"])
def test_malformed_json_is_one_line(served, body):
    status, content = ask(served, "/pictures", body)
    assert status == 422 and "\n" not in json.loads(content)["error"]


def spoiled(change) -> bytes:
    builder = scene()
    change(builder.document)
    return builder.glb()


def nan_vertices() -> bytes:
    builder = GltfBuilder()
    positions = np.array([[0, 0, 0], [1, 0, 0], [np.nan, 1, 0]])
    builder.node(builder.primitive(positions, np.arange(3)))
    return builder.glb()


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"", "not a GLB file"),
        (scene().glb()[:-30], "truncated"),
        (GltfBuilder().glb(), "no visible surface"),
        (nan_vertices(), "NaN"),
        (spoiled(lambda d: d["nodes"][0].update(scale=[1e300, 1, 1])), "infinite or too large"),
        (spoiled(lambda d: d["accessors"][0].update(count=10**12)), "accessors.0"),
        (spoiled(lambda d: d.update(
            images=[{"uri": "/etc/passwd"}], textures=[{"source": 0}],
            materials=[{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        ) or d["meshes"][0]["primitives"][0].update(material=0)), "did not come with it"),
    ],
)  # fmt: skip
def test_an_invalid_scene_is_one_line(served, content, why):
    status, answer = ask(served, "/scenes", content)
    error = json.loads(answer)["error"]
    assert status == 422 and why in error and "\n" not in error


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "rebound.example"},
        {"Origin": "http://page.example"},
        {"Origin": "null"},
        {"Rfpp_Protocol": None},
        {"Rfpp_Protocol": "2"},
    ],
)
def test_web_pages_and_other_versions_are_refused(served, headers):
    for path, body in (("/scenes", scene().glb()), ("/pictures", b"{}")):
        status, content = ask(served, path, body, **headers)
        assert status == 403 and json.loads(content)["error"]


def head(length: object) -> bytes:
    lines = ["POST /scenes HTTP/1.1", "Host: 127.0.0.1", "Rfpp-Protocol: 1", f"Content-Length: {length}", "", ""]
    return "\r\n".join(lines).encode()


@pytest.mark.parametrize("length", [-1, "1e3", 10**22])
def test_invalid_lengths_are_refused(served, length):
    with socket.create_connection(served.address, timeout=30) as connection:
        connection.sendall(head(length))
        assert connection.recv(4096).startswith(b"HTTP/1.1 400 ")


@pytest.mark.parametrize("size", [2 << 20, 9 << 20])
def test_large_bodies_are_discarded(served, size):
    with socket.create_connection(served.address, timeout=30) as connection:
        connection.sendall(head(size) + bytes(2 << 20))
        if size > 2 << 20:
            connection.sendall(bytes(3 << 20))
        assert connection.recv(4096).startswith(b"HTTP/1.1 413 ")
    status, content = ask(served, "/scenes", bytes(2 << 20))
    assert status == 413 and "more than 1,048,576 bytes" in json.loads(content)["error"]


def test_a_client_that_disconnects_while_sending_does_not_block_others(served):
    with socket.create_connection(served.address, timeout=30) as connection:
        connection.sendall(head(100) + b"glTF")
    assert send(served, scene().glb())


def test_requests_of_disconnected_clients_are_skipped():
    class Gated(Renderer):
        rendered = 0
        begun, resume = threading.Event(), threading.Event()

        def render(self, *args, **values):
            self.rendered += 1
            self.begun.set()
            assert self.resume.wait(60)
            return super().render(*args, **values)

    renderer = Gated(network(), checkpoint_info())
    with server(renderer) as served:
        body = VIEW | {"scene": send(served, scene().glb())}
        first = threading.Thread(target=ask, args=(served, "/pictures", body))
        first.start()
        assert renderer.begun.wait(60)
        content = json.dumps(body).encode()
        with socket.create_connection(served.address) as leaving:
            leaving.sendall(head(len(content)).replace(b"/scenes", b"/pictures") + content)
            ask(served, "/", None)  # by now the server has read the request
        ask(served, "/", None)  # and noticed that the client has left
        renderer.resume.set()
        first.join()
        assert ask(served, "/pictures", body)[0] == 200
    assert renderer.rendered == 2


def test_a_defect_is_reported_and_the_server_continues(caplog):
    class Defective(Renderer):
        def render(self, *args, **values):
            raise IndexError("list index out of range")

    with server(Defective(network(), checkpoint_info())) as served:
        name = send(served, scene().glb())
        status, content = ask(served, "/pictures", VIEW | {"scene": name})
        assert status == 500 and json.loads(content)["error"].startswith("IndexError in the server")
        assert send(served, scene().glb()) == name
    assert "list index out of range" in caplog.text


@pytest.mark.parametrize(("host", "port"), [("127.0.0.1", None), ("no.such.host.invalid", 0), ("127.0.0.1", 70_000)])
def test_an_unavailable_address_is_one_line(served, host, port):
    with pytest.raises(UserError, match="cannot listen at port"):
        Server(served.scenes.renderer, host, served.address[1] if port is None else port, 1)
