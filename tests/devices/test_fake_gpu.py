"""Every network on a GPU that is not there: nothing stays on the host, nothing is waited for, dtypes are right."""

from dataclasses import dataclass

import numpy as np
import pytest
import torch
from fake_gpu import GPU, fake_gpu, network_on
from network_variants import PAPER, VARIANTS, batch_for, loss

from rfpp.batch import RaggedBatch
from rfpp.inference import object_encoder
from rfpp.losses.transport_consistency import TransportConsistency
from rfpp.model.exposure import MeanIrradianceExposure
from rfpp.model.layers import attention
from rfpp.model.layers.ray_windows import ShiftedWindows
from rfpp.model.view_decoder import CameraTokens
from rfpp.segments import on_device
from rfpp.training.blocks import RecomputedObjects


@pytest.fixture(params=VARIANTS.values(), ids=VARIANTS.keys(), scope="module")
def variant(request) -> tuple[str, ...]:
    return request.param


#: Whose tokens are of objects, not of triangles.
WITH_OBJECTS = [name for name in VARIANTS if name not in ("renderformer", "renderformer_pitg")]


@dataclass(frozen=True)
class Step:
    """Observations of a forward pass in training: blocking copies, devices and dtypes of tensors."""

    waited_for: list[str]
    devices: dict[str, torch.device]
    dtypes: dict[str, torch.dtype]
    attention: set[torch.dtype]


@pytest.fixture(scope="module")
def step(variant) -> Step:
    taken, found, kernel = set(), {}, attention.attend_varlen
    with pytest.MonkeyPatch.context() as patch, fake_gpu() as copies:
        patch.setattr(attention, "attend_varlen", lambda *a: taken.add(a[0].dtype) or kernel(*a))
        patch.setattr(attention, "attend_bucketed", None)
        net = network_on(GPU, *variant).train()
        batch = batch_for(net).to(GPU, non_blocking=True)
        net.decoder.head.register_forward_hook(lambda _, __, maps: found.update(head=maps.dtype))
        net.decoder.blocks[0].cross_attention.out_proj.register_forward_hook(
            lambda _, __, x: found.update(layer=x.dtype)
        )
        copies.waited_for.clear()
        made = net(batch)
        terms = loss()(made.log_radiance, made.transport_states, batch.image, made.token_segments)
        waited_for = [*copies.waited_for]
        ends = {"log_radiance": made.log_radiance, "loss": terms["loss"]}
        states = {f"state {number}": state for number, state in enumerate(made.transport_states)}
        return Step(
            waited_for,
            {name: tensor.device for name, tensor in ends.items()},
            found | {name: tensor.dtype for name, tensor in (ends | states).items()},
            taken,
        )


def test_a_training_step_s_forward_pass_never_waits_for_the_device(step):
    assert step.waited_for == []
    assert step.devices == {"log_radiance": GPU, "loss": GPU}


def test_attention_in_half_precision_goes_to_the_variable_length_kernel(step):
    assert step.attention == {torch.bfloat16}


def test_images_and_light_are_float32_between_layers_in_half_precision(step):
    assert step.dtypes["layer"] == torch.bfloat16
    assert {name for name, dtype in step.dtypes.items() if dtype != torch.float32} == {"layer"}


def test_rendering_never_waits_for_the_device_before_the_image_is_there(variant):
    with fake_gpu() as copies:
        net = network_on(GPU, *variant).eval()
        batch = batch_for(net).to(GPU, non_blocking=True)
        copies.waited_for.clear()
        image = net.view(net.encode(batch), batch.c2w, batch.fov, batch.gbuffer)
        assert image.device == GPU and image.shape == (2, 2, 3, 16, 16)
        assert copies.waited_for == []


def test_what_a_graph_captures_neither_copies_nor_asks_for_lengths(variant):
    with fake_gpu() as copies:
        net = network_on(GPU, *variant).train()
        padded = batch_for(net).padded().to(GPU, non_blocking=True)
        exposure = net.exposure(padded)
        batch = padded.normalized(exposure)
        captured = batch.with_tensors(batch.tensors())
        copies.made.clear()
        made = net.rendered(captured, exposure)
        terms = loss()(made.log_radiance, made.transport_states, captured.image, made.token_segments)
        assert terms["loss"].device == GPU
        assert copies.made == []


#: Kernels of a picture: encoding and one view of two scenes. A change that launches more has to say why.
MOST_KERNELS = {"paper": 860, "renderformer": 600}


@pytest.mark.parametrize("name", MOST_KERNELS)
def test_a_picture_launches_no_more_kernels_than_before(name):
    with fake_gpu() as copies:
        net = network_on(GPU, *VARIANTS[name]).eval()
        batch = batch_for(net).padded().to(GPU, non_blocking=True)
        copies.kernels = 0
        net.view(net.encode(batch), batch.c2w, batch.fov, batch.gbuffer)
        assert copies.kernels <= MOST_KERNELS[name]


@pytest.mark.parametrize("name", WITH_OBJECTS)
def test_what_a_renderer_encodes_of_a_scene_on_the_host_is_on_the_device(name, monkeypatch):
    """Objects one by one and kept, their light beside them; their keys would need values."""
    monkeypatch.setattr(object_encoder, "object_keys", lambda batch, *_: list(range(len(batch.objects.lengths))))
    with fake_gpu():
        net = network_on(GPU, *VARIANTS[name]).eval()
        batch = batch_for(net, sizes=((14, 6, 1),))
        encoded = net.transported(*object_encoder.ObjectEncoder(net, GPU).tokenize(batch))
        seen = (x.to(GPU) for x in (batch.c2w, batch.fov, batch.gbuffer))
        assert net.view(encoded, *seen).device == GPU


@pytest.mark.parametrize("name", WITH_OBJECTS)
def test_objects_that_are_recomputed_one_by_one_are_not_waited_for(name):
    with fake_gpu() as copies:
        net = network_on(GPU, *VARIANTS[name]).train()
        RecomputedObjects(8)(net)
        batch = batch_for(net).to(GPU, non_blocking=True)
        copies.waited_for.clear()
        assert net(batch).log_radiance.device == GPU
        assert copies.waited_for == []


def test_only_rays_of_whole_views_go_to_the_kernel_that_is_planned_for_each_shape(variant, monkeypatch):
    """Numbers of tokens differ from scene to scene, even where a batch has one."""
    lengths, kernel = set(), attention.attend_equal
    monkeypatch.setattr(attention, "DENSE_FROM", 1)
    monkeypatch.setattr(attention, "attend_equal", lambda *a: lengths.add(a[-1].equal_length) or kernel(*a))
    with fake_gpu():
        net = network_on(GPU, *variant).eval()
        batch = batch_for(net, sizes=((14, 6, 1),)).to(GPU)
        assert net(batch).log_radiance.shape == (1, 2, 3, 16, 16)
    windows = isinstance(net.decoder.windows, ShiftedWindows)
    assert lengths == (set() if windows else {(16 // net.patch_size) ** 2})


def test_float32_runs_on_the_gpu_too(variant):
    with fake_gpu(autocast=False):
        net = network_on(GPU, *variant).eval()
        assert net(batch_for(net).to(GPU)).log_radiance.device == GPU


def test_gradients_have_a_place_for_every_parameter(variant):
    """On "meta", as gradients on a GPU that is not there would end the process."""
    net = network_on("meta", *variant).train()
    batch = batch_for(net).to("meta")
    made = net(batch)
    residuals = TransportConsistency()(made.transport_states, made.token_segments)
    (made.log_radiance.mean() + residuals.sum().to("meta")).backward()
    assert all(p.grad is not None and p.grad.is_meta and p.grad.shape == p.shape for p in net.parameters())


def _asks_for_a_value(batch: RaggedBatch) -> float:
    return batch.positions.sum().item()


def _leaves_numbers_on_the_host(batch: RaggedBatch) -> torch.Tensor:
    return batch.positions + torch.ones(len(batch.positions), 1, 1)


def _looks_for_nonzero_values(batch: RaggedBatch) -> torch.Tensor:
    return torch.nonzero(batch.material[:, 7])


def _counts_on_the_device(batch: RaggedBatch) -> torch.Tensor:
    return torch.repeat_interleave(torch.arange(2, device=GPU), batch.scenes.sizes)


@pytest.mark.parametrize(
    "fault", [_asks_for_a_value, _leaves_numbers_on_the_host, _looks_for_nonzero_values, _counts_on_the_device]
)
def test_what_needs_a_value_or_mixes_devices_fails(fault, monkeypatch):
    with fake_gpu():
        net = network_on(GPU, *VARIANTS["known_light"])
        batch = batch_for(net).to(GPU)
        monkeypatch.setattr(MeanIrradianceExposure, "__call__", lambda _, b: fault(b))
        with pytest.raises(Exception, match=r"(?i)local_scalar_dense|nonzero|repeat_interleave|device"):
            net(batch)


@pytest.mark.parametrize("fault", ["list", "numpy", "back"])
def test_copies_that_are_waited_for_are_seen(fault):
    with fake_gpu() as copies:
        on_device(np.arange(3), GPU)
        assert copies.waited_for == []
        if fault == "list":
            torch.tensor([1, 2, 3]).to(GPU)
        elif fault == "numpy":
            torch.from_numpy(np.arange(3)).to(GPU)
        else:
            torch.ones(3, device=GPU).cpu()
        assert len(copies.waited_for) == 1


def test_tokens_that_cameras_see_are_listed_scene_by_scene_and_view_by_view():
    net = network_on("cpu", *PAPER)
    batch = batch_for(net)
    _, tokens = net.tokenize(batch)
    seen = CameraTokens.by(tokens, batch.c2w)
    first = tokens.segments.lengths[0]
    assert seen.rows.tolist() == [*range(first)] * 2 + [*range(first, tokens.segments.total)] * 2
