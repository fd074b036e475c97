import numpy as np
import pytest
from networks import network
from random_scenes import random_views

from rfpp.batch import RaggedBatch
from rfpp.training.flops import training_flops


@pytest.mark.parametrize("experiment", ["large_scale", "[large_scale,paper/renderformer]"])
def test_fused_attention_is_counted_as_what_it_computes(experiment):
    """On "meta" there are no kernels: attention is composed of matrix products there."""
    net = network(f"experiment={experiment}")
    channels = 7 if net.gbuffer_channels else 0
    batch = RaggedBatch.pack([random_views(np.random.default_rng(0), (1000, 1), channels=channels)])
    counted = training_flops(net, batch)
    assert counted == training_flops(net.to("meta"), batch.to("meta"))
    width, triangles = 54, 1001
    assert counted > 3 * 4 * triangles**2 * width  # one layer of attention between the triangles of an object
