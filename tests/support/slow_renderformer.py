"""RenderFormer as its released checkpoints mean it, written apart from the package: one scene, one view, plain loops.

From the published description and code (github.com/microsoft/renderformer, MIT): tensor names are the released ones,
weights come as a dictionary, nothing is packed, folded or shared with rfpp.
"""

import math

import torch
import torch.nn.functional as F


def random_checkpoint(config: dict, seed: int = 0) -> dict[str, torch.Tensor]:
    """Tensors with the names and shapes of the released layout, for any sizes."""
    generator = torch.Generator().manual_seed(seed)
    d, h = config["latent_dim"], config["dim_feedforward"]
    patch, cells, features = config["patch_size"], config["texture_encode_patch_size"] ** 2, config["dpt_features"]
    levels = config["dpt_out_channels"]
    shapes = {
        "tri_token": (1, 1, d),
        "reg_tokens": (1, config["num_register_tokens"], d),
        "vn_encoding_proj.weight": (d, 9 * (1 + 2 * config["vn_pe_num_freqs"])),
        "vn_encoding_proj.bias": (d,),
        "vn_encoder_norm.weight": (d,),
        "texture_encoder.weight": (d, 13 * cells),
        "texture_encoder.bias": (d,),
        "texture_encoder_norm.weight": (d,),
    }
    for i in range(config["num_layers"]):
        layer = f"transformer.layers.{i}"
        shapes |= _attention_shapes(f"{layer}.multihead_attn", d, cross=False)
        shapes |= _feed_forward_shapes(layer, d, h) | {f"{layer}.query_norm.weight": (d,)}
    view = "view_transformer"
    shapes |= {
        f"{view}.ray_map_patch_token": (1, 1, d),
        f"{view}.ray_map_encoder.weight": (d, 3 * patch**2),
        f"{view}.ray_map_encoder.bias": (d,),
        f"{view}.ray_map_encoder_norm.weight": (d,),
    }
    for i in range(config["view_transformer_n_layers"]):
        layer = f"{view}.transformer.layers.{i}"
        shapes |= _attention_shapes(f"{layer}.multihead_attn", d, cross=True)
        shapes |= _attention_shapes(f"{layer}.self_attn", d, cross=False)
        shapes |= _feed_forward_shapes(layer, d, h)
        shapes |= {f"{layer}.{norm}_norm.weight": (d,) for norm in ("query", "kv", "self_attn")}
    dpt = f"{view}.out_dpt"
    for i, c in enumerate(levels):
        shapes |= {f"{dpt}.projects.{i}.weight": (c, d, 1, 1), f"{dpt}.projects.{i}.bias": (c,)}
        shapes[f"{dpt}.scratch.layer{i + 1}_rn.weight"] = (features, c, 3, 3)
        for unit in (1, 2) if i < 3 else (2,):
            for conv in (1, 2):
                name = f"{dpt}.scratch.refinenet{i + 1}.resConvUnit{unit}.conv{conv}"
                shapes |= {f"{name}.weight": (features, features, 3, 3), f"{name}.bias": (features,)}
        name = f"{dpt}.scratch.refinenet{i + 1}.out_conv"
        shapes |= {f"{name}.weight": (features, features, 1, 1), f"{name}.bias": (features,)}
    for i, size in ((0, 4), (1, 2), (3, 3)):
        shapes |= {f"{dpt}.resize_layers.{i}.weight": (levels[i], levels[i], size, size)}
        shapes |= {f"{dpt}.resize_layers.{i}.bias": (levels[i],)}
    for name, (out, inputs, size) in {
        "output_conv1": (features // 2, features, 3),
        "output_conv2.0": (features // 4, features // 2, 3),
        "output_conv2.2": (3, features // 4, 1),
    }.items():
        shapes |= {f"{dpt}.scratch.{name}.weight": (out, inputs, size, size), f"{dpt}.scratch.{name}.bias": (out,)}

    tensors = {}
    for name, shape in shapes.items():
        fan_in = math.prod(shape[1:]) if name.endswith("weight") and len(shape) > 1 else 4
        noise = torch.randn(shape, generator=generator)
        gain = 0.7 if "out_dpt" in name else 1.5  # nothing normalizes the image head's sums
        tensors[name] = 1 + 0.2 * noise if "norm.weight" in name else gain * noise / fan_in**0.5
    frequencies = 2 ** torch.linspace(0, math.log2(5), config["vertex_pe_num_freqs"] // 2)
    tensors["transformer.rope_emb.freqs"] = frequencies
    tensors["view_transformer.transformer.rope_emb.freqs"] = frequencies.clone()
    return tensors


def _attention_shapes(name: str, d: int, cross: bool) -> dict[str, tuple]:
    inputs = {f"{name}.{p}_proj.weight": (d, d) for p in "qkv"} if cross else {f"{name}.in_proj.weight": (3 * d, d)}
    return inputs | {
        f"{name}.out_proj.weight": (d, d), f"{name}.q_norm.weight": (d,), f"{name}.k_norm.weight": (d,)
    }  # fmt: skip


def _feed_forward_shapes(layer: str, d: int, h: int) -> dict[str, tuple]:
    shapes = {f"{layer}.ffn.w1.weight": (h, d), f"{layer}.ffn.w3.weight": (h, d), f"{layer}.ffn.w2.weight": (d, h)}
    return shapes | {f"{layer}.ffn_norm.weight": (d,)}


def triangle_tokens(w: dict, normals: torch.Tensor, texture: torch.Tensor, frequencies: int) -> torch.Tensor:
    """[M, D] from vertex normals [M, 3, 3] and linear texture patches [M, 13, P, P]."""
    flat = normals.reshape(len(normals), 9)
    bands = [flat[:, i] * 2.0**k for i in range(9) for k in range(frequencies)]
    angles = torch.stack(bands, dim=-1)
    encoded = torch.cat([flat, angles.sin(), (angles + torch.pi / 2).sin()], dim=-1)
    normal = F.linear(encoded, w["vn_encoding_proj.weight"], w["vn_encoding_proj.bias"])
    texture = texture.clone()
    texture[:, 10:] = torch.log10(texture[:, 10:] + 1)
    patch = F.linear(texture.reshape(len(texture), -1), w["texture_encoder.weight"], w["texture_encoder.bias"])
    default_eps = torch.finfo(torch.float32).eps
    return (
        w["tri_token"][0]
        + rms(patch, w["texture_encoder_norm.weight"], default_eps)
        + rms(normal, w["vn_encoder_norm.weight"], default_eps)
    )


def encode(w: dict, config: dict, triangles: torch.Tensor, normals: torch.Tensor, texture: torch.Tensor):
    """[registers + M, D] after the view-independent stage."""
    tokens = triangle_tokens(w, normals, texture, config["vn_pe_num_freqs"])
    x = torch.cat([w["reg_tokens"][0], tokens])
    angles = rotary_angles(with_registers(triangles, config), w["transformer.rope_emb.freqs"])
    for i in range(config["num_layers"]):
        layer = f"transformer.layers.{i}"
        h = rms(x, w[f"{layer}.query_norm.weight"])
        x = x + attention(w, f"{layer}.multihead_attn", h, h, config["num_heads"], angles, angles)
        x = x + feed_forward(w, layer, x)
    return x


def render(w: dict, config: dict, tokens: torch.Tensor, triangles: torch.Tensor, c2w, fov_degrees: float, size: int):
    """[3, size, size] linear radiance of one view."""
    p, heads = config["patch_size"], config["view_transformer_n_heads"]
    grid = size // p
    w2c = torch.linalg.inv(c2w)
    seen = triangles @ w2c[:3, :3].T + w2c[:3, 3]
    freqs = w["view_transformer.transformer.rope_emb.freqs"]
    context_angles = rotary_angles(with_registers(seen, config), freqs)

    centers = (torch.arange(size) + 0.5) / size * 2 - 1
    tangent = math.tan(math.radians(fov_degrees) / 2)
    rays = torch.stack(
        [
            (centers * tangent).expand(size, size),
            (-centers * tangent)[:, None].expand(size, size),
            -torch.ones(size, size),
        ]
    )
    rays = rays / rays.norm(dim=0)
    patches = [rays[:, r * p : (r + 1) * p, c * p : (c + 1) * p].reshape(-1) for r in range(grid) for c in range(grid)]
    bundle = F.linear(
        torch.stack(patches), w["view_transformer.ray_map_encoder.weight"], w["view_transformer.ray_map_encoder.bias"]
    )
    norm = w["view_transformer.ray_map_encoder_norm.weight"]
    x = w["view_transformer.ray_map_patch_token"][0] + rms(bundle, norm, torch.finfo(torch.float32).eps)
    ray_angles = torch.zeros(len(x), context_angles.shape[1])  # at the camera's origin

    features = []
    for i in range(config["view_transformer_n_layers"]):
        layer = f"view_transformer.transformer.layers.{i}"
        q, kv = rms(x, w[f"{layer}.query_norm.weight"]), rms(tokens, w[f"{layer}.kv_norm.weight"])
        x = x + attention(w, f"{layer}.multihead_attn", q, kv, heads, ray_angles, context_angles)
        h = rms(x, w[f"{layer}.self_attn_norm.weight"])
        if config["view_transformer_use_swin_attn"]:
            x = x + windowed(w, f"{layer}.self_attn", h, heads, grid, shift=4 if i % 2 else 0)
        else:
            x = x + attention(w, f"{layer}.self_attn", h, h, heads, ray_angles, ray_angles)
        x = x + feed_forward(w, layer, x)
        features.append(x.T.reshape(1, -1, grid, grid))
    return 10 ** F.elu(image_head(w, features[-4:], size), alpha=1e-3) - 1


def with_registers(triangles: torch.Tensor, config: dict) -> torch.Tensor:
    """[registers + M, 9]: registers stand at the mean vertex, three times."""
    center = triangles.reshape(-1, 3).mean(0).repeat(config["num_register_tokens"], 3)
    return torch.cat([center, triangles.reshape(-1, 9)])


def rotary_angles(points: torch.Tensor, frequencies: torch.Tensor) -> torch.Tensor:
    return torch.stack([points[:, i] * f for i in range(9) for f in frequencies], dim=-1)


def rms(x: torch.Tensor, weight: torch.Tensor, eps: float = 1e-6) -> torch.Tensor:
    return x / (x.pow(2).mean(-1, keepdim=True) + eps).sqrt() * weight


def rotated(x: torch.Tensor, angles: torch.Tensor) -> torch.Tensor:
    """[n, heads, d]: dimension i turns with dimension i + d/2; those without an angle stay."""
    half = x.shape[-1] // 2
    x = x.clone()
    for i in range(angles.shape[1]):
        a, b, t = x[..., i].clone(), x[..., i + half].clone(), angles[:, i, None]
        x[..., i], x[..., i + half] = a * t.cos() - b * t.sin(), b * t.cos() + a * t.sin()
    return x


def attention(w, name, query, context, heads, query_angles, context_angles, allowed=None) -> torch.Tensor:
    if f"{name}.in_proj.weight" in w:
        q, k, v = (F.linear(query, part) for part in w[f"{name}.in_proj.weight"].chunk(3))
    else:
        q, k, v = (
            F.linear(x, w[f"{name}.{p}_proj.weight"]) for p, x in zip("qkv", (query, context, context), strict=True)
        )
    q, k = rms(q, w[f"{name}.q_norm.weight"]), rms(k, w[f"{name}.k_norm.weight"])
    q, k, v = (x.reshape(len(x), heads, -1) for x in (q, k, v))
    if query_angles is not None:
        q, k = rotated(q, query_angles), rotated(k, context_angles)
    out = []
    for head in range(heads):
        scores = q[:, head] @ k[:, head].T / q.shape[-1] ** 0.5
        if allowed is not None:
            scores = scores.masked_fill(~allowed, -torch.inf)
        out.append(scores.softmax(-1) @ v[:, head])
    return F.linear(torch.cat(out, dim=-1), w[f"{name}.out_proj.weight"])


def windowed(w, name, x, heads, grid, shift, size=8) -> torch.Tensor:
    """Windows of a cyclically shifted grid, in which tokens that were not neighbors are masked (Liu et al. 2021)."""
    row, column = (i.ravel() for i in torch.meshgrid(torch.arange(grid), torch.arange(grid), indexing="ij"))
    r, c = (row - shift) % grid, (column - shift) % grid
    window = (r // size) * 1000 + c // size
    wrapped = (row < shift).long() * 2 + (column < shift).long()
    allowed = (window[:, None] == window) & (wrapped[:, None] == wrapped)
    return attention(w, name, x, x, heads, None, None, allowed)


def feed_forward(w, layer, x) -> torch.Tensor:
    h = rms(x, w[f"{layer}.ffn_norm.weight"])
    gated = F.silu(F.linear(h, w[f"{layer}.ffn.w1.weight"])) * F.linear(h, w[f"{layer}.ffn.w3.weight"])
    return F.linear(gated, w[f"{layer}.ffn.w2.weight"])


def image_head(w, features, size) -> torch.Tensor:
    dpt = "view_transformer.out_dpt"

    def conv(x, name, bias=True, **kwargs):
        return F.conv2d(x, w[f"{dpt}.{name}.weight"], w[f"{dpt}.{name}.bias"] if bias else None, **kwargs)

    def unit(x, name):
        y = conv(F.silu(x), f"{name}.conv1", padding=1)
        return x + conv(F.silu(y), f"{name}.conv2", padding=1)

    def resized(x, to):
        return F.interpolate(x, size=to, mode="bilinear", align_corners=True)

    maps = [conv(f, f"projects.{i}") for i, f in enumerate(features)]
    for i, stride in ((0, 4), (1, 2)):
        name = f"{dpt}.resize_layers.{i}"
        maps[i] = F.conv_transpose2d(maps[i], w[f"{name}.weight"], w[f"{name}.bias"], stride=stride)
    maps[3] = conv(maps[3], "resize_layers.3", stride=2, padding=1)
    maps = [conv(m, f"scratch.layer{i + 1}_rn", bias=False, padding=1) for i, m in enumerate(maps)]
    x = None
    for i in (3, 2, 1, 0):
        net = f"scratch.refinenet{i + 1}"
        x = maps[3] if x is None else x + unit(maps[i], f"{net}.resConvUnit1")
        x = unit(x, f"{net}.resConvUnit2")
        x = resized(x, maps[i - 1].shape[-2:] if i else (2 * x.shape[-2], 2 * x.shape[-1]))
        x = conv(x, f"{net}.out_conv")
    x = resized(conv(x, "scratch.output_conv1", padding=1), (size, size))
    x = F.silu(conv(x, "scratch.output_conv2.0", padding=1))
    return conv(x, "scratch.output_conv2.2")[0]
