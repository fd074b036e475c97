"""What the server answers, and to whom."""

import json
import socket
import threading
import time
import warnings

import numpy as np
import pytest
from gltf_files import GltfBuilder
from networks import checkpoint_info, network
from serving import VIEW, ask, scene, sent, server

from rfpp.errors import UserError
from rfpp.inference.renderer import Renderer
from rfpp.scene.io.loading import load_scene
from rfpp.scene.spec import Camera
from rfpp.serve.server import Server


@pytest.fixture(scope="module")
def served():
    with server() as made:
        yield made


def picture(served, name: str, **view: object) -> np.ndarray:
    status, content = ask(served, "/pictures", VIEW | {"scene": name} | view)
    assert status == 200, content
    return np.frombuffer(content, "<f4").reshape(*(VIEW | view)["size"], 4)


def test_it_says_who_it_is(served):
    status, content = ask(served, "/", None)
    assert status == 200 and json.loads(content) == {"protocol": 1, "network": "RenderFormer++"}


def test_a_picture_is_that_of_the_file(served, tmp_path):
    seen = picture(served, sent(served, scene().glb()), size=[24, 32])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        loaded = load_scene(scene().write(tmp_path), backdrop="none")
    # What stood at a point p stands at p / 4 there: the floor is four wide. Its box goes up to 1.
    camera = Camera(position=(0, -1.5, (1.5 - 0.5) / 4), look_at=(0, -1.5 + 0.98, 0.25 - 0.2), up=(0, 0.2, 0.98), fov=1)
    fov = 2 * np.degrees(np.arctan(0.4))
    renderer = Renderer(network(), checkpoint_info())
    [expected] = renderer.render(loaded, (24, 32), [camera.model_copy(update={"fov": fov})], 2, 1)
    assert expected.std() > 0.01
    np.testing.assert_allclose(seen[..., :3], expected, atol=1e-3 * expected.max())
    assert (seen[..., 3] == 1).all()


def test_a_scene_that_was_sent_is_not_sent_again_and_what_stayed_is_not_computed_again():
    renderer = Renderer(network(), checkpoint_info())
    with server(renderer) as served:
        name = sent(served, scene().glb())
        picture(served, name)
        encoded = renderer.engine.objects.encoded
        turned = [[1, 0, 0, 0.5], *VIEW["camera_to_world"][1:]]
        assert not np.array_equal(picture(served, name), picture(served, name, camera_to_world=turned))
        assert renderer.engine.objects.encoded == encoded
        assert sent(served, scene().glb()) == name
        picture(served, sent(served, scene(x=0.5).glb()))
        assert renderer.engine.objects.encoded == encoded + 1


def test_notes_say_what_was_changed(served):
    _, content = ask(served, "/scenes", scene(intensity=0.0).glb())
    notes = json.loads(content)["notes"]
    assert "it has no light: three lights are added" in notes
    assert "scaled by 0.25 and centered to fit into [-0.5, 0.5]³" in notes


def test_alpha_is_zero_where_nothing_is_seen(served):
    name = sent(served, scene().glb())
    alpha = picture(served, name, transparent=True)[..., 3]
    assert alpha[[0, -1]].max() == 0 and alpha[15, 8:24].min() == 1  # above, before and on the floor
    half = picture(served, name, transparent=True, supersampling=4)[..., 3]
    assert ((half > 0) & (half < 1)).any()


def test_a_scene_that_is_not_known_is_to_be_sent(served):
    status, content = ask(served, "/pictures", VIEW | {"scene": "0" * 32})
    assert status == 404 and "send it first" in json.loads(content)["error"]


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"size": [24]}, "picture.size"),
        ({"size": [24, 10**6]}, "picture.size.1"),
        ({"size": [16384, 16384], "window": [-0.4, 0.4, -0.4, 0.4], "supersampling": 8}, "of memory"),
        ({"light_samples": 0}, "picture.light_samples"),
        ({"supersampling": 99}, "picture.supersampling"),
        ({"window": [float("nan"), 0.4, -0.3, 0.3]}, "picture.window.0"),
        ({"window": [0.4, -0.4, -0.3, 0.3]}, "encloses nothing"),
        ({"camera_to_world": [[0, 0, 0, 0]] * 3}, "no direction"),
        ({"camera_to_world": [[1, 0, 0, 1e300]] * 3}, "picture.camera_to_world"),
        ({"camera_to_world": [[1, 0, 0, float("inf")]] * 3}, "picture.camera_to_world"),
        ({"surprise": 1}, "unknown key"),
        ({"scene": "x" * 1000}, "picture.scene"),
    ],
)
def test_a_bad_description_is_one_line(served, change, why):
    status, content = ask(served, "/pictures", VIEW | {"scene": sent(served, scene().glb())} | change)
    error = json.loads(content)["error"]
    assert status == 422 and why in error and "\n" not in error


@pytest.mark.parametrize("body", [b"", b"{", b"[]", b"\xff", b'{"a":' * 5_000, b'{"size":' + b"9" * 5000 + b"}"])
def test_what_is_no_description_is_one_line(served, body):
    status, content = ask(served, "/pictures", body)
    assert status == 422 and "\n" not in json.loads(content)["error"]


def spoiled(change) -> bytes:
    builder = scene()
    change(builder.document)
    return builder.glb()


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"", "not a GLB file"),
        (scene().glb()[:-30], "truncated"),
        (scene().gltf(), "not a GLB file"),
        (GltfBuilder().glb(), "no visible surface"),
        (spoiled(lambda d: d["nodes"][0].update(scale=[float("nan"), 1, 1])), "nodes"),
        (spoiled(lambda d: d["nodes"][0].update(scale=[1e300, 1, 1])), "infinite or too large"),
        (spoiled(lambda d: d["accessors"][0].update(count=10**12)), "accessors.0"),
        (spoiled(lambda d: d["images"] if "images" in d else d.update(
            images=[{"uri": "/etc/passwd"}], textures=[{"source": 0}],
            materials=[{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        ) or d["meshes"][0]["primitives"][0].update(material=0)), "did not come with it"),
    ],
)  # fmt: skip
def test_a_bad_scene_is_one_line(served, content, why):
    status, answer = ask(served, "/scenes", content)
    error = json.loads(answer)["error"]
    assert status == 422 and why in error and "\n" not in error


def test_nan_vertices_are_refused(served):
    builder = GltfBuilder()
    positions = np.array([[0, 0, 0], [1, 0, 0], [np.nan, 1, 0]])
    builder.node(builder.primitive(positions, np.arange(3)))
    status, answer = ask(served, "/scenes", builder.glb())
    assert status == 422 and "NaN" in json.loads(answer)["error"]


def test_pictures_that_are_not_finite_are_refused():
    broken = network()
    with server(Renderer(broken, checkpoint_info())) as served:
        name = sent(served, scene().glb())
        for weight in broken.parameters():
            weight.data.fill_(float("nan"))
        status, content = ask(served, "/pictures", VIEW | {"scene": name})
    assert status == 422 and "weights are not finite" in json.loads(content)["error"]


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Host": "rebound.example"}, 403),
        ({"Origin": "http://page.example"}, 403),
        ({"Origin": "null"}, 403),
        ({"Rfpp_Protocol": None}, 403),
        ({"Rfpp_Protocol": "2"}, 426),
    ],
)
def test_strangers_are_not_answered(served, headers, status):
    body = scene().glb()
    for path in ("/scenes", "/pictures"):
        assert ask(served, path, body, **headers)[0] == status
    assert ask(served, "/", None, **headers)[0] == status


def test_unknown_paths_and_methods_are_not_there(served):
    assert ask(served, "/../etc/passwd", b"")[0] == 404
    assert ask(served, "/favicon.ico", None)[0] == 404


def raw(served, text: bytes) -> bytes:
    with socket.create_connection(served.server_address[:2], timeout=30) as connection:
        connection.sendall(text)
        connection.shutdown(socket.SHUT_WR)
        return b"".join(iter(lambda: connection.recv(4096), b""))


@pytest.mark.parametrize(
    ("lines", "status"),
    [
        (b"", b" 411 "),
        (b"Content-Length: -1\r\n", b" 411 "),
        (b"Content-Length: 1e3\r\n", b" 411 "),
        (b"Content-Length: 9999999999999999999999\r\n", b" 411 "),
        (b"Content-Length: 5\r\nTransfer-Encoding: chunked\r\n", b" 411 "),
        (b"Content-Length: 9999999999999\r\n", b" 413 "),
    ],
)
def test_the_length_is_said_and_bounded(served, lines, status):
    head = b"POST /scenes HTTP/1.1\r\nHost: 127.0.0.1\r\nRfpp-Protocol: 1\r\n"
    assert status in raw(served, head + lines + b"\r\n").split(b"\r\n")[0]


def test_what_is_too_large_is_not_read(served):
    status, content = ask(served, "/scenes", bytes(2 << 20))
    assert status == 413 and "2,097,152 bytes are more than the 1,048,576" in json.loads(content)["error"]


def test_a_body_that_ends_early_is_let_go(served):
    head = b"POST /scenes HTTP/1.1\r\nHost: 127.0.0.1\r\nRfpp-Protocol: 1\r\nContent-Length: 100\r\n\r\n"
    assert raw(served, head + b"glTF") == b""
    assert sent(served, scene().glb())


def test_who_leaves_before_their_turn_is_passed_over():
    class Slow(Renderer):
        rendered = 0
        begun, goes_on = threading.Event(), threading.Event()

        def render(self, *args, **values):
            self.rendered += 1
            self.begun.set()
            assert self.goes_on.wait(60)
            return super().render(*args, **values)

    renderer = Slow(network(), checkpoint_info())
    with server(renderer) as served:
        body = VIEW | {"scene": sent(served, scene().glb())}
        first = threading.Thread(target=ask, args=(served, "/pictures", body))
        first.start()
        assert renderer.begun.wait(60)
        content = json.dumps(body).encode()
        with socket.create_connection(served.server_address[:2]) as leaving:
            head = f"POST /pictures HTTP/1.1\r\nHost: 127.0.0.1\r\nRfpp-Protocol: 1\r\nContent-Length: {len(content)}"
            leaving.sendall(f"{head}\r\n\r\n".encode() + content)
        while served._requests._value != 15:  # of sixteen: only the first is left
            time.sleep(0.01)
        renderer.goes_on.set()
        first.join()
        assert ask(served, "/pictures", body)[0] == 200
    assert renderer.rendered == 2


def test_a_defect_is_told_and_survived(capfd):
    class Defective(Renderer):
        def render(self, *args, **values):
            raise IndexError("list index out of range")

    with server(Defective(network(), checkpoint_info())) as served:
        name = sent(served, scene().glb())
        status, content = ask(served, "/pictures", VIEW | {"scene": name})
        assert status == 500 and json.loads(content)["error"].startswith("IndexError in the server")
        assert ask(served, "/", None)[0] == 200
    assert "list index out of range" in capfd.readouterr().err


def test_a_port_that_is_taken_is_said(served):
    port = served.server_address[1]
    with pytest.raises(UserError, match=rf"127\.0\.0\.1:{port}: cannot be listened at \(Address already in use\)"):
        Server(served.studio, "127.0.0.1", port, 1)
    with pytest.raises(UserError, match="cannot be listened at"):
        Server(served.studio, "no.such.host.invalid", 0, 1)
    with pytest.raises(UserError, match="cannot be listened at"):
        Server(served.studio, "127.0.0.1", 70_000, 1)
