"""Tokens that stand at the octants of their object, where its cells are."""

import numpy as np
import pytest
import torch
from networks import network
from scipy.spatial.transform import Rotation
from stored_sample import stored_sample

from rfpp.batch import RaggedBatch
from rfpp.errors import UserError
from rfpp.shards.views import select_views
from rfpp.training.augmentation import moved

OCTANTS = "experiment=[ablation,octant_tokens]"


@pytest.fixture(scope="module")
def net():
    return network(OCTANTS)


@pytest.fixture
def views(net):
    sample = stored_sample()
    return select_views(sample, range(len(sample.fov)), net.gbuffer_channels)


def test_each_token_stands_among_its_cells(net, views):
    batch = RaggedBatch.pack([views, views])
    anchors, cells = net.tokenizer.anchors(batch), batch.cells
    assert anchors.shape == (8 * len(batch.objects), 9)
    own = torch.linalg.vector_norm(cells.centre - anchors[cells.octant, 3:6], dim=-1)
    whole = torch.linalg.vector_norm(cells.centre - anchors[cells.octant, :3], dim=-1)
    assert own.sum() < 0.7 * whole.sum()
    for octant in cells.octant.unique():
        of_octant = cells.octant == octant
        expected = np.average(cells.centre[of_octant].numpy(), axis=0, weights=cells.area[of_octant].numpy())
        np.testing.assert_allclose(anchors[octant, 3:6].numpy(), expected, atol=1e-5)


def test_tokens_move_with_their_objects(net, views):
    rotation, shift = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix(), np.array([0.3, 0.1, -0.2])
    before = net.tokenizer.anchors(RaggedBatch.pack([views])).view(-1, 3, 3).numpy()
    after = net.tokenizer.anchors(RaggedBatch.pack([moved(views, rotation, shift)])).view(-1, 3, 3).numpy()
    np.testing.assert_allclose(after, before @ rotation.T + shift, atol=1e-5)


def test_what_knows_no_octants_is_refused(net, views):
    batch = RaggedBatch.pack([views])
    with pytest.raises(ValueError, match="no cells"):
        net.tokenizer.anchors(RaggedBatch.pack([views.__class__(**{**vars(views), "cells": None})]))
    with pytest.raises(UserError, match="eight octants"):
        network(OCTANTS, "model.tokenizer.queries=4").tokenizer.anchors(batch)
