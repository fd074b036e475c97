"""Convert the released RenderFormer checkpoints to our layout.

Layout: github.com/microsoft/renderformer (MIT), RenderFormer V1 base and V1.1 swin large.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from rfpp.checkpoint.model_folder import CONFIG_FILE, WEIGHTS_FILE
from rfpp.errors import CheckpointError
from rfpp.model.layers.encoding import RelativeSpatialEncoding
from rfpp.scene.texture import FLAT_NORMAL, MATERIAL_CHANNELS, NORMAL_CHANNELS, TEXTURE_CHANNELS, covered_cells

#: The released code's defaults, for keys that a config.json omits.
_DEFAULTS: dict[str, Any] = {
    "latent_dim": 768, "num_layers": 12, "num_heads": 6, "dim_feedforward": 3072, "num_register_tokens": 16,
    "dropout": 0.0, "activation": "swiglu", "norm_type": "rms_norm", "norm_first": True, "view_indep_qk_norm": True,
    "qk_norm": True, "bias": False, "pe_type": "rope", "rope_type": "triangle", "rope_double_max_freq": False,
    "vertex_pe_num_freqs": 12, "use_vn_encoder": True, "vn_pe_num_freqs": 6, "vn_encoder_norm_type": "rms_norm",
    "texture_encode_patch_size": 32, "texture_channels": 13, "texture_encoder_norm_type": "rms_norm",
    "view_transformer_latent_dim": 768, "view_transformer_ffn_hidden_dim": 3072, "view_transformer_n_heads": 6,
    "view_transformer_n_layers": 6, "view_transformer_include_self_attn": True,
    "view_transformer_use_swin_attn": False, "vdir_pe_type": "nerf", "vdir_num_freqs": 0, "patch_size": 8,
    "include_alpha": False, "use_dpt_decoder": True, "dpt_features": 128, "dpt_out_channels": [96, 192, 384, 768],
    "dpt_out_layers": None, "turn_to_cam_coord": True, "use_ldr": False,
}  # fmt: skip
#: Keys whose value may differ from the default; a dropout does nothing at inference.
_FREE = {
    "latent_dim", "num_layers", "num_heads", "dim_feedforward", "num_register_tokens", "dropout", "vn_pe_num_freqs",
    "texture_encode_patch_size", "view_transformer_latent_dim", "view_transformer_ffn_hidden_dim",
    "view_transformer_n_heads", "view_transformer_n_layers", "view_transformer_use_swin_attn", "patch_size",
    "dpt_features", "dpt_out_channels",
}  # fmt: skip
#: The width of the swin variant's windows, in patches; the released code fixes it.
_WINDOW = 8


def released(
    config: dict[str, Any], tensors: dict[str, Tensor], folder: Path
) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """Return the network's `_target_` config and its weights under our names.

    Args:
        config, tensors: Content of the folder.
        folder: Folder, for errors.

    Raises:
        CheckpointError: If a tensor is missing or unknown, or a config value is not supported.
    """
    config, tensors = _known(config, folder / CONFIG_FILE), dict(tensors)
    try:
        weights = dict(_renamed(config, tensors))
        _check_frequencies(config, tensors, folder / WEIGHTS_FILE)
    except KeyError as error:
        raise CheckpointError(f"{folder / WEIGHTS_FILE}: lacks the tensor {error}: copy it again") from None
    if tensors:  # unused
        raise CheckpointError(
            f"{folder / WEIGHTS_FILE}: has the unknown tensor {min(tensors)} (and {len(tensors) - 1} more): "
            "it belongs to another model"
        )
    return _model(config), weights


def with_folded_texture(weights: dict[str, Tensor]) -> dict[str, Tensor]:
    """Return the weights of the same network with TriangleEmbedding in place of TexturePatchEmbedding; exact."""
    weights = dict(weights)
    patches = weights.pop("embedding.texture_proj.weight").unflatten(1, (TEXTURE_CHANNELS, -1))
    covered = torch.from_numpy(covered_cells(math.isqrt(patches.shape[-1]))).flatten()
    of_channel = patches[..., covered].sum(-1)  # [D, 13]
    flat = of_channel[:, NORMAL_CHANNELS] @ torch.tensor(FLAT_NORMAL)
    weights["embedding.material_proj.weight"] = of_channel[:, torch.from_numpy(MATERIAL_CHANNELS)]
    weights["embedding.material_proj.bias"] = weights.pop("embedding.texture_proj.bias") + flat
    weights["embedding.material_norm.weight"] = weights.pop("embedding.texture_norm.weight")
    return weights


def _known(given: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return the configuration with its defaults. Raises CheckpointError if it is not supported."""
    if unknown := sorted(given.keys() - _DEFAULTS.keys()):
        raise CheckpointError(f"{path}: unknown key '{unknown[0]}': it belongs to an unknown version of RenderFormer")
    for key, default in _DEFAULTS.items():
        if key not in _FREE and given.get(key, default) != default:
            raise CheckpointError(f"{path}: {key} is {given[key]!r}, only {default!r} is supported")
    config = _DEFAULTS | given
    for view, scene in (("view_transformer_latent_dim", "latent_dim"), ("view_transformer_n_heads", "num_heads")):
        if config[view] != config[scene]:
            raise CheckpointError(f"{path}: {view} is {config[view]}, only {scene} ({config[scene]}) is supported")
    if config["view_transformer_ffn_hidden_dim"] != config["dim_feedforward"]:
        raise CheckpointError(f"{path}: view_transformer_ffn_hidden_dim differs from dim_feedforward: not supported")
    return config


def _model(config: dict[str, Any]) -> dict[str, Any]:
    """Return the config of RenderFormer, as in conf/model/renderformer.yaml, with the released embedding."""
    attention = {"width": config["latent_dim"], "heads": config["num_heads"], "hidden": config["dim_feedforward"]}
    frequencies = config["vertex_pe_num_freqs"] // 2
    windows = {"_target_": "rfpp.model.layers.ray_windows.WholeView"}
    if config["view_transformer_use_swin_attn"]:
        windows = {"_target_": "rfpp.model.layers.ray_windows.ShiftedWindows", "size": _WINDOW}
    return {
        "_target_": "rfpp.model.renderformer_pp.RenderFormerPP",
        "embedding": {
            "_target_": "rfpp.model.renderformer.texture_patches.TexturePatchEmbedding",
            "width": config["latent_dim"],
            "normal_frequencies": config["vn_pe_num_freqs"],
            "patch_size": config["texture_encode_patch_size"],
        },
        "tokenizer": {
            "_target_": "rfpp.model.renderformer.triangle_tokens.TriangleTokens",
            "width": config["latent_dim"],
            "registers": config["num_register_tokens"],
        },
        "transport": {
            "_target_": "rfpp.model.renderformer.transport.UnconstrainedTransport",
            **attention,
            "layers": config["num_layers"],
            "frequencies": frequencies,
        },
        "decoder": {
            "_target_": "rfpp.model.view_decoder.ViewDecoder",
            **attention,
            "layers": config["view_transformer_n_layers"],
            "frequencies": frequencies,
            "patch_size": config["patch_size"],
            "gbuffer_channels": [],
            "head_level_channels": config["dpt_out_channels"],
            "head_channels": config["dpt_features"],
            "windows": windows,
        },
        "exposure": {"_target_": "rfpp.model.exposure.UnitExposure"},
    }


def _renamed(config: dict[str, Any], tensors: dict[str, Tensor]) -> Iterator[tuple[str, Tensor]]:
    """Yield (our name, tensor) and remove it from `tensors`. Raises KeyError if one is missing."""
    take = tensors.pop
    yield "embedding.token", take("tri_token").flatten()
    yield "tokenizer.registers", take("reg_tokens")[0]
    for ours, theirs in _EMBEDDING.items():
        yield ours, take(theirs)
    for i in range(config["num_layers"]):
        ours, theirs = f"transport.blocks.{i}", f"transformer.layers.{i}"
        yield from _attention(tensors, f"{ours}.attention", f"{theirs}.multihead_attn")
        yield f"{ours}.attention.in_proj.weight", take(f"{theirs}.multihead_attn.in_proj.weight")
        yield f"{ours}.attention_norm.weight", take(f"{theirs}.query_norm.weight")
        yield from _feed_forward(tensors, ours, theirs)

    yield "decoder.rays.token", take("view_transformer.ray_map_patch_token").flatten()
    for ours, theirs in _RAYS.items():
        yield ours, take(theirs)
    for i in range(config["view_transformer_n_layers"]):
        ours, theirs = f"decoder.blocks.{i}", f"view_transformer.transformer.layers.{i}"
        yield from _attention(tensors, f"{ours}.cross_attention", f"{theirs}.multihead_attn")
        yield f"{ours}.cross_attention.q_proj.weight", take(f"{theirs}.multihead_attn.q_proj.weight")
        stacked = [take(f"{theirs}.multihead_attn.{part}_proj.weight") for part in "kv"]
        yield f"{ours}.cross_attention.kv_proj.weight", torch.cat(stacked)
        yield from _attention(tensors, f"{ours}.self_attention", f"{theirs}.self_attn")
        yield f"{ours}.self_attention.in_proj.weight", take(f"{theirs}.self_attn.in_proj.weight")
        for norm, their_norm in (("query", "query"), ("context", "kv"), ("self_attention", "self_attn")):
            yield f"{ours}.{norm}_norm.weight", take(f"{theirs}.{their_norm}_norm.weight")
        yield from _feed_forward(tensors, ours, theirs)
    yield from _image_head(tensors)


_EMBEDDING = {
    "embedding.texture_proj.weight": "texture_encoder.weight",
    "embedding.texture_proj.bias": "texture_encoder.bias",
    "embedding.texture_norm.weight": "texture_encoder_norm.weight",
    "embedding.normal_proj.weight": "vn_encoding_proj.weight",
    "embedding.normal_proj.bias": "vn_encoding_proj.bias",
    "embedding.normal_norm.weight": "vn_encoder_norm.weight",
}
_RAYS = {
    "decoder.rays.proj.weight": "view_transformer.ray_map_encoder.weight",
    "decoder.rays.proj.bias": "view_transformer.ray_map_encoder.bias",
    "decoder.rays.norm.weight": "view_transformer.ray_map_encoder_norm.weight",
}


def _check_frequencies(config: dict[str, Any], tensors: dict[str, Tensor], path: Path) -> None:
    """Remove RSPE's frequencies from `tensors`. Raises KeyError, or CheckpointError if they differ from ours."""
    count = config["vertex_pe_num_freqs"] // 2
    expected = RelativeSpatialEncoding(18 * count, count).frequencies  # in the narrowest head that holds them
    for transformer in ("transformer", "view_transformer.transformer"):
        name = f"{transformer}.rope_emb.freqs"
        found = tensors.pop(name)
        if found.shape != expected.shape or not torch.allclose(found, expected, rtol=1e-4):
            raise CheckpointError(f"{path}: {name} differ from RSPE's frequencies: not supported")


def _attention(tensors: dict[str, Tensor], ours: str, theirs: str) -> Iterator[tuple[str, Tensor]]:
    for name in ("out_proj", "q_norm", "k_norm"):
        yield f"{ours}.{name}.weight", tensors.pop(f"{theirs}.{name}.weight")


def _feed_forward(tensors: dict[str, Tensor], ours: str, theirs: str) -> Iterator[tuple[str, Tensor]]:
    gate, value = tensors.pop(f"{theirs}.ffn.w1.weight"), tensors.pop(f"{theirs}.ffn.w3.weight")
    yield f"{ours}.feed_forward.in_proj.weight", torch.cat([gate, value])
    yield f"{ours}.feed_forward.out_proj.weight", tensors.pop(f"{theirs}.ffn.w2.weight")
    yield f"{ours}.feed_forward_norm.weight", tensors.pop(f"{theirs}.ffn_norm.weight")


def _image_head(tensors: dict[str, Tensor]) -> Iterator[tuple[str, Tensor]]:
    head, dpt = "decoder.head", "view_transformer.out_dpt"

    def layer(ours: str, theirs: str, kinds: tuple[str, ...] = ("weight", "bias")) -> Iterator[tuple[str, Tensor]]:
        for kind in kinds:
            yield f"{head}.{ours}.{kind}", tensors.pop(f"{dpt}.{theirs}.{kind}")

    for level in range(4):
        yield from layer(f"project.{level}", f"projects.{level}")
        if level != 2:  # keeps its size
            yield from layer(f"resample.{level}", f"resize_layers.{level}")
        yield from layer(f"to_common.{level}", f"scratch.layer{level + 1}_rn", ("weight",))
        ours, theirs = f"fuse.{level}", f"scratch.refinenet{level + 1}"
        units = {"refine_skip": "resConvUnit1", "refine": "resConvUnit2"}
        if level == 3:  # the coarsest level has no skip connection
            del units["refine_skip"]
        for unit, their_unit in units.items():
            for conv in ("conv1", "conv2"):
                yield from layer(f"{ours}.{unit}.{conv}", f"{theirs}.{their_unit}.{conv}")
        yield from layer(f"{ours}.out", f"{theirs}.out_conv")
    yield from layer("smooth", "scratch.output_conv1")
    yield from layer("out.0", "scratch.output_conv2.0")
    yield from layer("out.2", "scratch.output_conv2.2")
