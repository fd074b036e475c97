"""A server with a small network, and a scene to send to it."""

from __future__ import annotations

import http.client
import json
from collections.abc import Iterator
from contextlib import contextmanager

from gltf_files import GltfBuilder
from networks import checkpoint_info, network

from rfpp.inference.renderer import Renderer
from rfpp.serve.server import PROTOCOL, Server

#: View from the front, slightly above, with square pixels.
VIEW = {
    "camera_to_world": [[1, 0, 0, 0], [0, 0.2, -0.98, -6], [0, 0.98, 0.2, 1.5]],
    "window": [-0.4, 0.4, -0.3, 0.3],
    "size": [24, 32],
    "light_samples": 2,
    "supersampling": 1,
    "transparent": False,
}


def scene(x: float = 0.0, intensity: float = 683.0 * 40) -> GltfBuilder:
    """Return a floor, an upright square at x, and a point light."""
    builder = GltfBuilder()
    floor = builder.node(builder.primitive(), scale=[4, 1, 4])
    square = builder.node(builder.primitive(), rotation=[0.70710678, 0, 0, 0.70710678], translation=[x, 0.5, 0])
    light = {"type": "point", "intensity": intensity}
    lamp = builder.node(extensions={"KHR_lights_punctual": {"light": 0}}, translation=[1, 2, 2])
    builder.document["extensions"] = {"KHR_lights_punctual": {"lights": [light]}}
    builder.document |= {"scenes": [{"nodes": [floor, square, lamp]}], "scene": 0}
    return builder


@contextmanager
def server(renderer: Renderer | None = None, max_bytes: int = 1 << 20) -> Iterator[Server]:
    """Run a server on a free port."""
    with Server(renderer or Renderer(network(), checkpoint_info()), "127.0.0.1", 0, max_bytes) as started:
        yield started


def ask(server: Server, path: str, body: bytes | dict | None, **headers: str | None) -> tuple[int, bytes]:
    """Return status and content of a response. A header of None is omitted."""
    connection = http.client.HTTPConnection(*server.address, timeout=60)
    content = json.dumps(body).encode() if isinstance(body, dict) else body
    given = {"Rfpp-Protocol": str(PROTOCOL)} | {name.replace("_", "-"): value for name, value in headers.items()}
    try:
        method = "GET" if body is None else "POST"
        connection.request(method, path, content, {name: value for name, value in given.items() if value is not None})
        response = connection.getresponse()
        return response.status, response.read()
    finally:
        connection.close()


def send(server: Server, content: bytes) -> str:
    """Send a scene and return its name."""
    status, answer = ask(server, "/scenes", content)
    assert status == 200, answer
    return json.loads(answer)["scene"]
