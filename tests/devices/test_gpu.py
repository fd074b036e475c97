"""On a GPU: what it computes is what a CPU computes, in values and gradients, and it is never waited for in between."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
import torch
from attention_inputs import attend_loop, random_qkv, values_and_gradients
from fake_gpu import network_on
from gpu_runs import captured_against_plain, compile_whole_blocks
from marks import requires_gpu
from network_variants import VARIANTS, batch_for, loss
from small_data import make
from training_runs import finish, start, train, wait_for_step

from rfpp import Renderer
from rfpp.inference.captured import CapturedStages
from rfpp.model.layers.attention import (
    DENSE_FROM,
    AttentionPattern,
    attend_bucketed,
    attend_equal,
    attend_varlen,
)
from rfpp.scene.io.loading import load_scene
from rfpp.segments import Segments
from rfpp.training.blocks import RecomputedBlocks, RecomputedObjects


@contextlib.contextmanager
def exact_products():
    """Products of float32 in float32; TF32 has ten bits."""
    before = torch.get_float32_matmul_precision(), torch.backends.cudnn.allow_tf32
    torch.set_float32_matmul_precision("highest")
    torch.backends.cudnn.allow_tf32 = False
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(before[0])
        torch.backends.cudnn.allow_tf32 = before[1]


def relative(found: torch.Tensor, expected: torch.Tensor) -> float:
    found, expected = found.double().cpu(), expected.double().cpu()
    return float((found - expected).norm() / expected.norm().clamp(min=1e-12))


@requires_gpu
@pytest.mark.parametrize("dim", [64, 96, 128])
@pytest.mark.parametrize("kind", ["self", "queries of objects", "views", "rays"])
def test_all_backends_agree_in_values_and_gradients(dim, kind):
    rng = np.random.default_rng(dim)
    lengths = [1024] * 3 if kind == "rays" else rng.integers(1, 700, 23).tolist()
    queries = lengths if kind in ("self", "rays") else [8 if kind == "queries of objects" else 256] * 23
    equal = lengths[0] if kind == "rays" else 0
    patterns = {
        device: AttentionPattern(*(Segments.from_lengths(n, device) for n in (queries, lengths)), equal_length=equal)
        for device in ("cpu", "cuda")
    }
    qkv = [t.bfloat16() for t in random_qkv(patterns["cpu"].queries, patterns["cpu"].keys, dim=dim)]
    on_gpu = [t.cuda() for t in qkv]
    expected = values_and_gradients(attend_loop, *[t.double() for t in qkv], patterns["cpu"])
    cases = {"varlen": (attend_varlen, on_gpu, 1e-2), "padded": (attend_bucketed, on_gpu, 1e-2)}
    if kind == "rays":
        assert patterns["cuda"].equal_length >= DENSE_FROM
        cases["equal"] = (attend_equal, on_gpu, 1e-2)
    with exact_products():
        cases["padded, float32"] = (attend_bucketed, [t.float() for t in on_gpu], 1e-4)
        cases["loop, float32"] = (attend_loop, [t.float() for t in on_gpu], 1e-4)
        for name, (backend, inputs, most) in cases.items():
            for found, right in zip(values_and_gradients(backend, *inputs, patterns["cuda"]), expected, strict=True):
                assert relative(found, right) < most, name


def gradients(net, batch, **autocast) -> dict[str, torch.Tensor]:
    net.zero_grad()
    with torch.autocast(batch.positions.device.type, torch.bfloat16, **autocast):
        made = net(batch)
        terms = loss()(made.log_radiance, made.transport_states, batch.image, made.token_segments)
    terms["loss"].backward()
    return {"loss": terms["loss"].detach(), **{name: p.grad.clone() for name, p in net.named_parameters()}}


@requires_gpu
@pytest.mark.parametrize("variant", VARIANTS.values(), ids=VARIANTS.keys())
def test_a_training_step_is_that_of_the_cpu(variant):
    torch.manual_seed(0)
    net = network_on("cpu", *variant).train()
    batch = batch_for(net, resolution=32)
    expected = gradients(net, batch, enabled=False)
    net = net.cuda()
    with exact_products():
        exact = gradients(net, batch.to("cuda"), enabled=False)
    assert relative(exact["loss"], expected["loss"]) < 1e-5
    whole = [torch.cat([g[name].flatten().cpu() for name in expected if name != "loss"]) for g in (expected, exact)]
    assert relative(whole[1], whole[0]) < 1e-3
    rounded = gradients(net, batch.to("cuda"))
    assert relative(rounded["loss"], expected["loss"]) < 1e-2
    rounded = torch.cat([rounded[name].flatten().cpu() for name in expected if name != "loss"])
    assert torch.cosine_similarity(rounded.double(), whole[0].double(), dim=0) > 0.98


#: Scenes of one padded size.
SIMILAR = [((14, 6, 1), (3, 9, 2, 1, 2)), ((13, 6, 2), (4, 7, 2, 2, 1))]


@requires_gpu
@pytest.mark.parametrize("compiled", [False, True], ids=["as written", "compiled"])
@pytest.mark.parametrize("variant", ["paper", "renderformer"])
def test_a_captured_step_is_the_plain_one(variant, compiled, in_process):
    differences, graphs = in_process(captured_against_plain, VARIANTS[variant], SIMILAR, compiled)
    assert graphs == 1
    assert max(differences["losses"]) < 0.01
    assert max(differences["gradients"]) < 0.05


@requires_gpu
def test_a_replayed_picture_is_the_plain_one():
    torch.manual_seed(0)
    net = network_on("cuda", *VARIANTS["paper"]).eval()
    stages = CapturedStages(net)
    batches = [batch_for(net, resolution=32, sizes=sizes[:1]) for sizes in SIMILAR]
    assert batches[0].padded().shape == batches[1].padded().shape
    with torch.inference_mode(), torch.autocast("cuda", torch.bfloat16):
        for batch in (batches[0], *batches):  # without a graph, captured, and replayed for another scene
            scenes = stages.encode(batch.padded().to("cuda"))
            seen = [x.to("cuda") for x in (batch.c2w, batch.fov, batch.gbuffer)]
            expected = net.view(net.encode(batch.to("cuda")), *seen)
            assert relative(stages.view(scenes, *seen), expected) < 1e-2


@requires_gpu
@pytest.mark.parametrize("policy", [None, RecomputedBlocks(), RecomputedObjects(15)], ids=["kept", "blocks", "objects"])
@pytest.mark.parametrize("variant", ["paper", "known_light"])
def test_a_training_step_never_waits_for_the_gpu(variant, policy):
    net = network_on("cuda", *VARIANTS[variant]).train()
    if policy:
        policy(net)
    optimizer = torch.optim.AdamW(net.parameters(), fused=True)
    batch = batch_for(net, resolution=32).pin_memory()

    def step() -> None:
        moved = batch.to("cuda", non_blocking=True)
        with torch.autocast("cuda", torch.bfloat16):
            made = net(moved)
            terms = loss()(made.log_radiance, made.transport_states, moved.image, made.token_segments)
        optimizer.zero_grad()
        terms["loss"].backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        optimizer.step()

    step()  # moments, handles and plans are made
    torch.cuda.synchronize()
    torch.cuda.set_sync_debug_mode("error")
    try:
        step()
    finally:
        torch.cuda.set_sync_debug_mode("default")


@requires_gpu
@pytest.mark.parametrize("scene", ["cornell_box", "roughness_spheres"])
def test_images_are_those_of_the_cpu(scene):
    scene = load_scene(f"data/scenes/{scene}.json")
    images = {}
    for device, precision in (("cpu", "fp32"), ("cuda", "fp32"), ("cuda", "bf16")):
        with exact_products():
            renderer = Renderer.load("radiosity", device=device, precision=precision)
            images[device, precision] = np.log10(1 + renderer.render(scene, resolution=64))
    expected = images["cpu", "fp32"]
    assert np.abs(images["cuda", "fp32"] - expected).max() < 1e-3
    assert np.abs(images["cuda", "bf16"] - expected).mean() < 0.02 * expected.mean()


@requires_gpu
def test_blocks_compile_without_a_break(in_process):
    differences, compilations = in_process(compile_whole_blocks, VARIANTS["paper"])
    assert max(differences) < 0.05
    assert compilations[-1] == compilations[1], "other numbers of tokens are compiled anew"


#: Where summing in another order, as a GPU does from run to run, is not magnified as Adam does with small gradients.
ON_GPU = (
    "logger=none", "trainer.accelerator=gpu", "size.width=64", "steps=8", "trainer.val_check_interval=4",
    "optimizer._target_=torch.optim.SGD", "optimizer.lr=0.3", "trainer.precision=32-true",
)  # fmt: skip


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return make(tmp_path_factory.mktemp("data") / "small", splits={"train": 7, "validation": 2}).root


@pytest.fixture(scope="module")
def uninterrupted(data, tmp_path_factory) -> torch.Tensor:
    return weights(train(tmp_path_factory.mktemp("runs") / "whole", data, *ON_GPU))


def weights(checkpoint: dict) -> torch.Tensor:
    return torch.cat([w.flatten().cpu() for name, w in sorted(checkpoint["state_dict"].items())])


@requires_gpu
def test_a_killed_run_goes_on_where_it_was(data, uninterrupted, tmp_path):
    begun = start(tmp_path / "killed", data, *ON_GPU)
    wait_for_step(tmp_path / "killed", 3)
    for process in begun:
        process.kill()
    finish(begun)
    resumed = train(tmp_path / "killed", data, *ON_GPU)
    assert resumed["global_step"] == 8
    assert relative(weights(resumed), uninterrupted) < 1e-5


@requires_gpu
@pytest.mark.parametrize("ranks", [1, 2])
def test_processes_of_nccl_train_as_one_without(ranks, data, uninterrupted, tmp_path):
    if torch.cuda.device_count() < ranks:
        pytest.skip(f"fewer than {ranks} GPUs")
    strategy = () if ranks > 1 else ("trainer.strategy=ddp",)
    trained = train(tmp_path / "nccl", data, *ON_GPU, *strategy, ranks=ranks)
    assert relative(weights(trained), uninterrupted) < 1e-5
