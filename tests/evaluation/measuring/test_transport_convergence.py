"""The transport operator applied again and again: the trace, and the report on it."""

import csv

import numpy as np
import pytest
import torch
from networks import checkpoint_info, network

from rfpp.batch import RaggedBatch
from rfpp.errors import UserError
from rfpp.evaluation.measuring.transport_convergence import trace_transport
from rfpp.evaluation.report.transport_report import write_transport_report
from rfpp.imaging.radiance import log_decode
from rfpp.losses.transport_consistency import TransportConsistency
from rfpp.metrics.image import log_l1
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.views import select_views


@pytest.fixture(scope="module")
def split(data_root):
    return ShardSplit(data_root, "test")


@pytest.mark.parametrize("overrides", [(), ("model=renderformer", "model/transport=encoded_physics_informed")])
def test_the_trace_passes_through_the_trained_network(split, cpu, overrides):
    net = network(*overrides)
    trace = trace_transport(net, split, 5, 2, cpu)
    assert trace.trained == 3
    assert trace.residual.shape == trace.error.shape == trace.change.shape == (5, 3)
    assert trace.radiance.shape == (5, 2, 16, 16, 3)

    sample = split[1]
    views = select_views(sample, range(len(sample.fov)), net.gbuffer_channels)
    with torch.no_grad():
        rendering = net(RaggedBatch.pack([views]))
        image = log_decode(rendering.log_radiance[0]).clamp_min(0)
        residuals = TransportConsistency()(net.train()(RaggedBatch.pack([views])).transport_states)
    np.testing.assert_allclose(trace.radiance[3, 1], image[0].permute(1, 2, 0).numpy(), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(trace.residual[1:4, 1], residuals.numpy(), rtol=1e-4)
    reference = torch.from_numpy(sample.images).permute(0, 3, 1, 2)
    np.testing.assert_allclose(trace.error[3, 1], log_l1(image, reference).mean().item(), rtol=1e-4)


def test_each_state_is_the_operator_of_the_one_before(split, cpu):
    trace = trace_transport(network(), split, 4, 3, cpu)
    first = torch.from_numpy(trace.radiance[:, 0]).permute(0, 3, 1, 2)
    assert (trace.change > 0).all() and (trace.residual > 0).all()
    assert not torch.allclose(first[0], first[1])


def test_a_network_without_an_operator_is_refused(split, cpu):
    with pytest.raises(UserError, match="UnconstrainedTransport applies no operator"):
        trace_transport(network("model/transport=unconstrained"), split, 2, 1, cpu)


def test_the_report_holds_every_state(split, cpu, tmp_path):
    trace = trace_transport(network(), split, 4, 2, cpu)
    files = write_transport_report(trace, checkpoint_info(), "3 scenes", tmp_path)
    assert {file.name for file in files} == {"transport.csv", "curves.png", "images.png", "index.html"}
    rows = list(csv.DictReader((tmp_path / "transport.csv").open()))
    assert [row["k"] for row in rows] == ["0", "1", "2", "3"]
    assert float(rows[2]["residual_median"]) == pytest.approx(np.median(trace.residual[2]), rel=1e-4)
    page = (tmp_path / "index.html").read_text()
    assert "K = 3" in page and "images.png" in page and "curves.png" in page
