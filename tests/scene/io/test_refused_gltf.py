"""glTF that cannot be represented, is damaged or means harm is refused in one line that names it."""

import json
import math
from collections.abc import Callable
from pathlib import Path

import pytest
from gltf_files import GltfBuilder

from rfpp.errors import SceneError
from rfpp.scene.io.loading import load_scene


def changed(change: Callable[[dict], object]) -> Callable[[GltfBuilder], bytes]:
    def make(builder: GltfBuilder) -> bytes:
        builder.glb()
        change(builder.document)
        return builder.gltf() if "uri" not in json.dumps(builder.document) else json.dumps(builder.document).encode()

    return make


def of_material(**values: object) -> Callable[[GltfBuilder], bytes]:
    return changed(lambda d: d["materials"][0].update(values))


def extension(name: str, **values: object) -> Callable[[GltfBuilder], bytes]:
    return of_material(extensions={name: values})


def absurd(document: dict) -> None:
    document["accessors"][0]["count"] = 10**9


REFUSED = {
    "blending": (
        of_material(alphaMode="BLEND", pbrMetallicRoughness={"baseColorFactor": [1, 1, 1, 0.5]}),
        r"material 'glass' \(alphaMode BLEND\): is transparent",
    ),
    "transmission": (
        extension("KHR_materials_transmission", transmissionFactor=1),
        r"'glass' \(transmission\): is transparent",
    ),
    "translucency": (
        extension("KHR_materials_diffuse_transmission", diffuseTransmissionFactor=1),
        r"'glass' \(transmission\): is transparent",
    ),
    "environment": (changed(lambda d: d.update(extensionsUsed=["EXT_lights_image_based"])), "light of an environment"),
    "compression": (
        changed(lambda d: d.update(extensionsRequired=["KHR_draco_mesh_compression"])),
        "needs KHR_draco_mesh_compression, which cannot be read: decompress it with npx @gltf-transform/cli copy",
    ),
    "meshopt": (
        changed(lambda d: d.update(extensionsRequired=["EXT_meshopt_compression"])),
        "needs EXT_meshopt_compression, which cannot be read: decompress it with npx @gltf-transform/cli copy",
    ),
    "compressed primitive": (
        changed(lambda d: d["meshes"][0]["primitives"][0].update(extensions={"KHR_draco_mesh_compression": {}})),
        "'plane': KHR_draco_mesh_compression cannot be read",
    ),
    "unknown extension": (changed(lambda d: d.update(extensionsRequired=["X\nY"])), "needs X Y, which cannot be read"),
    "version": (changed(lambda d: d["asset"].update(version="1.0")), "glTF version '1.0' cannot be read"),
    "no asset": (changed(lambda d: d.pop("asset")), "glTF version '' cannot be read"),
    "a cycle": (changed(lambda d: d["nodes"][0].update(children=[0])), "nodes.0 occurs twice|no node belongs"),
    "a longer cycle": (
        changed(lambda d: (d["nodes"].extend([{"children": [0]}]), d["nodes"][0].update(children=[1]),
                           d.update(scenes=[{"nodes": [0]}]))),
        "nodes.0 occurs twice in the hierarchy",
    ),
    "a missing child": (changed(lambda d: d["nodes"][0].update(children=[7])), "nodes.7 is referred to"),
    "a missing mesh": (changed(lambda d: d["nodes"][0].update(mesh=7)), "meshes.7 is referred to"),
    "absurd count": (changed(absurd), "accessors.0: 1,000,000,000 elements .* more than its bytes hold"),
    "no data": (changed(lambda d: d["accessors"][0].pop("bufferView")), "accessors.0: sparse or empty"),
    "negative": (changed(lambda d: d["accessors"][0].update(count=-1)), "accessors.0.count: "),
    "beyond the buffer": (changed(lambda d: d["bufferViews"][0].update(byteOffset=10**6)), "a buffer view ends at"),
    "of another type": (changed(lambda d: d["accessors"][0].update(type="VEC2")), "VEC2 of 5126 where VEC3"),
    "a bad index": (changed(lambda d: d["accessors"][0].update(count=2)), "refers to vertex 3 of 2"),
    "NaN": (changed(lambda d: d["nodes"][0].update(translation=[0, math.nan, 0])), "nodes.0.translation.1: "),
    "overflow": (changed(lambda d: d["nodes"][0].update(scale=[1e308] * 3, translation=[1e308] * 3)),
                 "infinite or too large"),
    "nothing": (changed(lambda d: d.update(nodes=[])), "no visible surface"),
    "instances": (
        changed(lambda d: d["nodes"][0].update(extensions={"EXT_mesh_gpu_instancing": {}})), "export its instances"
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_represented_or_is_damaged_is_refused_by_name(case: str, tmp_path: Path) -> None:
    make, message = REFUSED[case]
    builder = GltfBuilder()
    builder.node(builder.primitive(material={"name": "glass"}), name="plane")
    (tmp_path / "scene.gltf").write_bytes(make(builder))
    with pytest.raises(SceneError, match=message) as caught:
        load_scene(tmp_path / "scene.gltf", transparent="refuse")
    assert str(caught.value).startswith(f"{tmp_path / 'scene.gltf'}: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("uri", "message"),
    [
        ("../secret.bin", "leads out of the file's folder"),
        ("%2e%2e/secret.bin", "leads out of the file's folder"),
        ("..\\secret.bin", "leads out of the file's folder"),
        ("{}/secret.bin", "leads out of the file's folder"),
        ("file://{}/secret.bin", "is not a file path"),
        ("https://example.org/a.bin", "is not a file path"),
        ("data:;base64,!!!!", "is not base64"),
        ("gone.bin", "gone.bin: cannot be read"),
        ("short.bin", "3 of 140 bytes are there"),
        (".", "not a regular file"),
        ("a\0b", "is not a file path"),
        ("x" * 300, "is too long for a file path"),
        ("xy/" * 2000, "is too long for a file path"),
    ],
)
def test_buffers_lie_beside_the_file_and_are_whole(uri: str, message: str, tmp_path: Path) -> None:
    builder = GltfBuilder()
    builder.node(builder.primitive(material={}))
    builder.view(bytes(140 - len(builder.binary)))
    folder = tmp_path / "inner"
    folder.mkdir()
    (tmp_path / "secret.bin").write_bytes(builder.binary)
    (folder / "short.bin").write_bytes(b"abc")
    (folder / "scene.gltf").write_bytes(builder.gltf(uri.format(tmp_path)))
    with pytest.raises(SceneError, match=message):
        load_scene(folder / "scene.gltf")


def test_a_truncated_glb_is_named(tmp_path: Path) -> None:
    builder = GltfBuilder()
    builder.node(builder.primitive())
    content = builder.glb()
    for length in range(0, len(content), 7):
        (tmp_path / "cut.glb").write_bytes(content[:length])
        with pytest.raises(SceneError, match=r"cut\.glb: (is empty|is not a GLB|is truncated)"):
            load_scene(tmp_path / "cut.glb")


def test_many_instances_of_a_mesh_are_counted_before_they_are_made(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("rfpp.scene.io.limits.MAX_TRIANGLES", 100)
    builder = GltfBuilder()
    mesh = builder.node(builder.primitive())
    builder.document["nodes"] += [{"mesh": mesh}] * 50
    with pytest.raises(SceneError, match="102 triangles are more than 100"):
        load_scene(builder.write(tmp_path))
