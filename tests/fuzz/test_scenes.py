import json
import struct
import warnings
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import trimesh
from fuzzing import attempt, fuzzed
from gltf_files import SQUARE, SQUARE_UV, GltfBuilder
from hypothesis import given
from hypothesis import strategies as st
from mutations import JSON_VALUES, altered, damaged, dumped, reworded
from PIL import Image

from rfpp import Renderer, Scene
from rfpp.errors import SceneError, UserError
from rfpp.scene.io.loading import load_scene
from rfpp.scene.io.saving import save_scene
from rfpp.scene.packed import PackedScene, pack
from rfpp.scene.spec import Camera, Material, SceneObject

pytestmark = pytest.mark.timeout(36_000)  # of thousands

EXAMPLES = Path(__file__).parents[2] / "data" / "scenes"
MATERIAL = Material(diffuse=(0.5,) * 3, specular=(0.1,) * 3, roughness=0.5)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("fuzzed")
    trimesh.creation.icosphere(1).export(folder / "ball.obj")
    Image.fromarray(np.full((4, 4, 3), 128, np.uint8)).save(folder / "a.png")
    (folder / "a.mtl").write_text(MTL)
    return folder


@cache
def renderer() -> Renderer:
    return Renderer.load("radiosity", "cpu")


def load(path: Path, content: bytes) -> None:
    """Passes if the file is a scene whose picture is finite, or is refused in one line that names it."""
    path.write_bytes(content)
    with attempt(f"scenes, {path.suffix[1:]}") as one:
        scene, refusal = _loaded(path)
        if scene is None:
            assert str(path) in refusal
            assert "\n" not in refusal
            return
        assert np.isfinite(scene.triangles.positions).all()
        assert np.isfinite(scene.triangles.material).all()
        if len(scene.fov):
            one.taken = _drawn(scene)


def _loaded(path: Path) -> tuple[PackedScene | None, str]:
    with warnings.catch_warnings():
        warnings.filterwarnings("error", category=RuntimeWarning)  # arithmetic on numbers that should have been refused
        warnings.filterwarnings("ignore", category=UserWarning)
        try:
            return pack(load_scene(path)), ""
        except SceneError as error:
            return None, str(error)


def _drawn(scene: PackedScene) -> bool:
    """Whether it has a picture, which is finite, or is refused in one line."""
    model = renderer()
    try:
        image = model.render(scene.views([0]), 16, light_samples=1, supersampling=1)
    except UserError as error:
        refusal = str(error)
    else:
        assert np.isfinite(image).all()
        return True
    assert "\n" not in refusal
    return False


def full_gltf() -> GltfBuilder:
    """Every kind of thing that is read."""
    builder = GltfBuilder()
    attributes = {
        "TEXCOORD_0": builder.accessor(SQUARE_UV),
        "NORMAL": builder.accessor(np.array([[0, 1, 0]] * 4)),
        "COLOR_0": builder.accessor(np.full((4, 4), 200), "u1", normalized=True),
        "JOINTS_0": builder.accessor(np.zeros((4, 4)), "u1"),
        "WEIGHTS_0": builder.accessor(np.array([[1, 0, 0, 0]] * 4)),
    }
    texture = builder.texture(np.random.default_rng(0).integers(0, 255, (4, 4, 4)))
    builder.document["samplers"] = [{"wrapS": 33071, "wrapT": 33648}]
    builder.document["textures"][0]["sampler"] = 0
    moved = {"offset": [0.1, 0.2], "scale": [2.0, 1.0], "rotation": 0.3}
    material = {
        "name": "all", "alphaMode": "MASK", "alphaCutoff": 0.2, "emissiveFactor": [0, 0, 0],
        "pbrMetallicRoughness": {"baseColorTexture": texture | {"extensions": {"KHR_texture_transform": moved}},
                                 "metallicRoughnessTexture": texture}, "normalTexture": texture | {"scale": 0.5},
        "extensions": {"KHR_materials_ior": {"ior": 1.4}, "KHR_materials_specular": {"specularFactor": 0.5},
                       "KHR_materials_emissive_strength": {"emissiveStrength": 2.0}},
    }  # fmt: skip
    skin = {"joints": [0], "inverseBindMatrices": builder.accessor(np.eye(4).reshape(1, 16))}
    builder.document["skins"] = [skin]
    builder.document["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "point", "intensity": 1000}]}}
    camera = builder.add("cameras", {"type": "perspective", "perspective": {"yfov": 0.7, "aspectRatio": 1.5}})
    light = {"KHR_lights_punctual": {"light": 0}}
    builder.node(builder.primitive(material=material, attributes=attributes), name="square", children=[1])
    builder.node(name="child", matrix=np.eye(4).ravel().tolist(), camera=camera, extensions=light)
    builder.node(builder.primitive(SQUARE[0] + 1), skin=0, rotation=[0, 0, 0, 1], scale=[1, 2, 1])
    builder.document["scenes"] = [{"nodes": [0, 2]}]
    builder.document["scene"] = 0
    builder.gltf()
    return builder


GLTF = full_gltf()
GLB = GLTF.glb()
DOCUMENT = json.loads(GLTF.gltf())


@fuzzed
@given(damaged(GLB))
def test_damaged_glb(folder: Path, content: bytes) -> None:
    load(folder / "scene.glb", content)


@fuzzed
@given(altered(DOCUMENT))
def test_altered_gltf(folder: Path, document: dict) -> None:
    load(folder / "scene.gltf", dumped(document))


@fuzzed
@given(altered({key: value for key, value in DOCUMENT.items() if key != "buffers"}))
def test_altered_glb(folder: Path, document: dict) -> None:
    """With its buffer whole, so that the fault lies in what is said of it."""
    document.setdefault("buffers", [{"byteLength": len(GLTF.binary)}])
    text = dumped(document)
    chunks = [(b"JSON", text), (b"BIN\0", GLTF.binary)]
    body = b"".join(struct.pack("<I4s", len(content), kind) + content for kind, content in chunks)
    load(folder / "altered.glb", struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)


MTL = "newmtl a\nKd 0.5 0.4 0.3\nKs 0.5 0.5 0.5\nNs 200\nillum 2\nmap_Kd a.png\nnewmtl b\nKe 1 1 1\nPr 0.3\nPm 0.1\n"
OBJ = (
    "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0.5 0.5 1\nvt 0 0\nvt 1 0\nvt 1 1\nvn 0 0 1\n"
    "o base\nusemtl a\ns 1\nf 1/1/1 2/2/1 3/3/1 4/1/1\ng top\nusemtl b\nf 1 2 5\nf 2 3 5\n"
)


@fuzzed
@given(damaged(OBJ.encode()) | reworded(OBJ.encode()))
def test_damaged_obj(folder: Path, content: bytes) -> None:
    load(folder / "scene.obj", content)


@fuzzed
@given(damaged(MTL.encode()) | reworded(MTL.encode()))
def test_damaged_mtl(folder: Path, content: bytes) -> None:
    (folder / "damaged.mtl").write_bytes(content)
    load(folder / "with_mtl.obj", OBJ.replace("a.mtl", "damaged.mtl").encode())


def ply(encoding: str) -> bytes:
    ball = trimesh.creation.icosphere(1)
    ball.visual.vertex_colors = np.full((len(ball.vertices), 4), 99, np.uint8)
    return ball.export(file_type="ply", encoding=encoding)


@fuzzed
@given(damaged(ply("binary")) | damaged(ply("ascii")) | reworded(ply("ascii")))
def test_damaged_ply(folder: Path, content: bytes) -> None:
    load(folder / "scene.ply", content)


@fuzzed
@given(st.sampled_from(["stl", "stl_ascii"]).flatmap(lambda kind: damaged(_stl(kind))))
def test_damaged_stl(folder: Path, content: bytes) -> None:
    load(folder / "scene.stl", content)


def _stl(kind: str) -> bytes:
    content = trimesh.creation.icosphere(1).export(file_type=kind)
    return content.encode() if isinstance(content, str) else content


JSON_SCENE = {
    "scene_name": "plain",
    "version": "1.0",
    "objects": {
        "ball": {
            "mesh_path": "ball.obj",
            "material": {
                "diffuse": [0.5, 0.5, 0.5], "specular": [0, 0, 0], "roughness": 0.5, "emissive": [0, 0, 0],
                "smooth_shading": True, "rand_tri_diffuse_seed": 3, "random_diffuse_max": 0.4,
            },
            "transform": {"translation": [0, 0, 0], "rotation": [0, 0, 10], "scale": [1, 1, 1], "normalize": True},
            "remesh": True,
            "remesh_target_face_num": 40,
        }
    },
    "cameras": [{"position": [0, -2, 0], "look_at": [0, 0, 0], "up": [0, 0, 1], "fov": 40}],
}  # fmt: skip


@fuzzed
@given(altered(JSON_SCENE) | JSON_VALUES)
def test_altered_renderformer_json(folder: Path, document: object) -> None:
    load(folder / "scene.json", dumped(document))


@fuzzed
@given(damaged(dumped(JSON_SCENE)))
def test_damaged_renderformer_json(folder: Path, content: bytes) -> None:
    load(folder / "scene.json", content)


def h5_bytes(folder: Path) -> bytes:
    camera = Camera(position=(0, -2, 0), look_at=(0, 0, 0), fov=40)
    mesh = load_scene(EXAMPLES / "cornell_box.json").objects[0].mesh
    scene = Scene(objects=(SceneObject(name="a", mesh=mesh, material=MATERIAL),), cameras=(camera,))
    return save_scene(scene, folder / "whole.h5").read_bytes()


@fuzzed
@given(data=st.data())
def test_damaged_h5(folder: Path, data: st.DataObject) -> None:
    content = h5_bytes(folder) if not (folder / "whole.h5").exists() else (folder / "whole.h5").read_bytes()
    load(folder / "scene.h5", data.draw(damaged(content)))


@fuzzed
@given(st.sampled_from([".glb", ".gltf", ".obj", ".ply", ".stl", ".json", ".h5"]), st.binary(max_size=300))
def test_bytes_that_mean_nothing(folder: Path, suffix: str, content: bytes) -> None:
    with pytest.raises(UserError):
        pack(load_scene(_written(folder / f"noise{suffix}", content)))


def _written(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path
