"""Our RenderFormer against a slow one of its own, from a checkpoint in the released layout."""

import json
from dataclasses import replace

import h5py
import numpy as np
import pytest
import torch
from known_scenes import look_at, still_life
from networks import checkpoint_info, network
from safetensors.torch import save_file
from slow_renderformer import encode, random_checkpoint, render, triangle_tokens

from rfpp import Renderer
from rfpp.batch import RaggedBatch, SceneViews
from rfpp.checkpoint.loading import load_initial_weights, load_network
from rfpp.errors import CheckpointError
from rfpp.scene.io.loading import load_scene
from rfpp.scene.packed import PackedScene
from rfpp.scene.texture import FLAT_NORMAL, covered_cells

CONFIG = {
    "latent_dim": 216, "num_layers": 2, "num_heads": 2, "dim_feedforward": 96, "num_register_tokens": 3,
    "vn_pe_num_freqs": 6, "vertex_pe_num_freqs": 12, "texture_encode_patch_size": 32, "patch_size": 8,
    "view_transformer_latent_dim": 216, "view_transformer_ffn_hidden_dim": 96, "view_transformer_n_heads": 2,
    "view_transformer_n_layers": 4, "view_transformer_use_swin_attn": False,
    "dpt_features": 16, "dpt_out_channels": [8, 8, 12, 16],
}  # fmt: skip
POSE, FOV = look_at((0.3, -1.5, 0.9), (0, 0, 0.1)), 40.0
SIZE = 128  # 16 × 16 patches, two windows along each side


@pytest.fixture(params=[False, True], ids=["base", "swin"])
def config(request) -> dict:
    return CONFIG | {"view_transformer_use_swin_attn": request.param}


def write(folder, config, tensors=None):
    folder.mkdir(exist_ok=True)
    (folder / "config.json").write_text(json.dumps(config))
    save_file(random_checkpoint(config) if tensors is None else tensors, folder / "model.safetensors")
    return folder


@pytest.fixture(scope="module")
def scene() -> PackedScene:
    return PackedScene("still life", still_life(), POSE[None], np.array([FOV], np.float32))


def patches(scene: PackedScene) -> np.ndarray:
    """Constant texture patches of a scene's materials, as the official converter writes them."""
    material = scene.triangles.material
    flat = np.broadcast_to(np.float32(FLAT_NORMAL), (len(material), 3))
    values = np.concatenate([material[:, :7], flat, material[:, 7:]], axis=1)
    return values[:, :, None, None] * covered_cells(32).astype(np.float32)


def slowly(config, scene: PackedScene, texture) -> np.ndarray:
    weights = random_checkpoint(config)
    triangles, normals = torch.from_numpy(scene.triangles.positions), torch.from_numpy(scene.triangles.normals)
    tokens = encode(weights, config, triangles, normals, torch.from_numpy(texture))
    return render(weights, config, tokens, triangles, torch.from_numpy(POSE), FOV, SIZE).permute(1, 2, 0).numpy()


def test_every_stage_agrees(tmp_path, config, scene):
    network, _ = load_network(write(tmp_path / "released", config))
    weights = random_checkpoint(config)
    batch = RaggedBatch.pack(
        [SceneViews("s", scene.triangles, POSE[None], np.array([FOV]), np.zeros((1, 0, 128, 128)))]
    )
    texture = torch.from_numpy(patches(scene))
    with torch.no_grad():
        embedded = network.embedding(batch)
        expected = triangle_tokens(weights, batch.normals, texture, config["vn_pe_num_freqs"])
        torch.testing.assert_close(embedded, expected, rtol=1e-4, atol=1e-4)
        encoded = network.encode(batch).tokens.features
        expected = encode(weights, config, batch.positions, batch.normals, texture)
        torch.testing.assert_close(encoded, expected, rtol=1e-4, atol=1e-4 * expected.abs().max().item())


def test_the_radiance_agrees(tmp_path, config, scene):
    image = Renderer.load(write(tmp_path / "released", config), "cpu", "fp32").render(scene, SIZE)[0]
    expected = slowly(config, scene, patches(scene)).clip(0)
    assert expected.std() > 0.05 * expected.mean()
    assert np.abs(image - expected).max() < 1e-4 * expected.max()


def write_h5(path, scene: PackedScene, texture: np.ndarray):
    with h5py.File(path, "w") as file:
        file["triangles"], file["vn"] = scene.triangles.positions, scene.triangles.normals
        file["texture"], file["c2w"], file["fov"] = texture, scene.c2w, scene.fov
    return path


def test_textured_triangles_take_the_whole_patch(tmp_path, scene):
    texture = patches(scene)
    shades = np.random.default_rng(0).uniform(0.2, 1, (len(texture), 1, 32, 32)).astype(np.float32)
    texture[:, :3] *= shades
    loaded = load_scene(write_h5(tmp_path / "textured.h5", scene, texture))
    assert loaded.texture is not None
    renderer = Renderer.load(write(tmp_path / "released", CONFIG), "cpu", "fp32")
    image, expected = renderer.render(loaded, SIZE)[0], slowly(CONFIG, scene, texture).clip(0)
    assert np.abs(image - expected).max() < 1e-4 * expected.max()
    plain = renderer.render(replace(loaded, texture=None), SIZE)[0]
    assert np.abs(image - plain).max() > 1e-3 * expected.max()


def refusal(folder) -> str:
    with pytest.raises(CheckpointError) as caught:
        load_network(folder)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_what_does_not_fit_is_refused_by_name(tmp_path):
    tensors = random_checkpoint(CONFIG)
    missing = {k: v for k, v in tensors.items() if k != "transformer.layers.1.ffn.w3.weight"}
    assert "lacks the tensor 'transformer.layers.1.ffn.w3.weight'" in refusal(write(tmp_path / "a", CONFIG, missing))
    extra = tensors | {"view_transformer.out_proj.weight": torch.zeros(3)}
    assert "unknown tensor view_transformer.out_proj.weight" in refusal(write(tmp_path / "b", CONFIG, extra))
    wider = CONFIG | {"dim_feedforward": 100, "view_transformer_ffn_hidden_dim": 100}
    assert "has another shape for" in refusal(write(tmp_path / "c", wider, tensors))
    assert "rope_type is 'triangle_learned'" in refusal(
        write(tmp_path / "d", CONFIG | {"rope_type": "triangle_learned"})
    )
    assert "unknown key 'color'" in refusal(write(tmp_path / "e", CONFIG | {"color": 1}))
    other = tensors | {"transformer.rope_emb.freqs": torch.arange(1.0, 7.0)}
    assert "transformer.rope_emb.freqs" in refusal(write(tmp_path / "f", CONFIG, other))
    folder = write(tmp_path / "g", CONFIG)
    (folder / "model.safetensors").write_bytes((folder / "model.safetensors").read_bytes()[:1000])
    assert "cannot be read" in refusal(folder)


def test_training_starts_from_the_released_weights(tmp_path, scene):
    sizes = ("size.width=216", "size.heads=2", "size.hidden=96", "size.frequencies=6", "size.unconstrained_layers=2")
    head = ("size.head_level_channels=[8,8,12,16]", "size.head_channels=16", "model.tokenizer.registers=3")
    ours = network("model=renderformer", *sizes, *head)
    released = write(tmp_path / "released", CONFIG)
    load_initial_weights(ours, released)
    image = Renderer(ours, checkpoint_info(resolution=(64, 64))).render(scene)
    expected = Renderer.load(released, "cpu", "fp32").render(scene, 64)
    assert np.abs(image - expected).max() < 1e-4 * expected.max()
    with pytest.raises(CheckpointError, match="belongs to another model"):
        load_initial_weights(network("model=renderformer"), released)
