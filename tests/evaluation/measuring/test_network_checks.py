import pytest
import torch
from networks import network

from rfpp.batch import RaggedBatch
from rfpp.evaluation.measuring.network_checks import ablation_growth, transport_convergence
from rfpp.losses.ablation import TokenFeatures, ablated
from rfpp.losses.log_l1 import log_l1
from rfpp.losses.transport_consistency import TransportConsistency
from rfpp.shards.views import select_views

CPU = torch.device("cpu")
WITH_OPERATOR = [
    ("experiment=large_scale",),
    ("experiment=[large_scale,paper/renderformer_pitg]",),
]


def _batch(net, split, index: int) -> RaggedBatch:
    return RaggedBatch.pack([select_views(split[index], range(2), net.gbuffer_channels)])


@torch.no_grad()
def test_growth_uses_the_first_scenes_of_the_split(test_split) -> None:
    net = network("experiment=large_scale")
    first, second = (_batch(net, test_split, index) for index in range(2))
    growth = ablation_growth(net, test_split, CPU, scenes=2)
    unmodified = log_l1(net(second).log_radiance, second.image)
    for name, image in ablated(net, second, TokenFeatures.of(net, first)).items():
        assert growth[name] == pytest.approx((log_l1(image, second.image) / unmodified - 1).item(), rel=1e-3, abs=1e-5)
    assert ablation_growth(net, test_split, CPU, scenes=1) == ablation_growth(net, test_split, CPU, scenes=0) == {}


@pytest.mark.parametrize("overrides", WITH_OPERATOR)
def test_the_trace_passes_through_the_trained_network(test_split, overrides) -> None:
    net = network(*overrides)
    trace = transport_convergence(net, test_split, CPU, scenes=1)
    assert len(trace["residual"]) == len(trace["log_l1"]) == 2 * net.iterations + 1
    batch = _batch(net, test_split, 0)
    with torch.no_grad():
        error = log_l1(net(batch).log_radiance, batch.image).item()
        residuals = TransportConsistency()(net.train()(batch).transport_states)
    assert trace["log_l1"][net.iterations] == pytest.approx(error, rel=1e-4)
    assert trace["residual"][1 : net.iterations + 1] == pytest.approx(residuals.tolist(), rel=1e-4)


@pytest.mark.parametrize(("experiment", "scenes"), [("[large_scale,paper/renderformer]", 1), ("large_scale", 0)])
def test_without_an_operator_or_scenes_there_is_no_trace(test_split, experiment, scenes) -> None:
    assert transport_convergence(network(f"experiment={experiment}"), test_split, CPU, scenes) == {}
