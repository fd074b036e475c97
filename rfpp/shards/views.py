"""Views of stored scenes in the form networks read."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from torch.utils.data import Dataset

from rfpp.batch import SceneViews
from rfpp.raycast.first_hit import stack_channels
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.sample import SceneSample


def select_views(sample: SceneSample, views: Sequence[int], channels: Sequence[str]) -> SceneViews:
    """Return some views of a stored scene with the given G-buffer channels, channels first."""
    material, chosen = sample.triangles.material, list(views)
    gbuffer = [stack_channels(sample.gbuffers[v], material, float(sample.fov[v]), channels) for v in chosen]
    return SceneViews(
        key=sample.key,
        triangles=sample.triangles,
        c2w=sample.c2w[chosen],
        fov=sample.fov[chosen],
        gbuffer=np.stack(gbuffer),
        image=np.ascontiguousarray(sample.images[chosen].transpose(0, 3, 1, 2)),
        token_light=sample.token_light,
    )


class AllViews(Dataset):
    """Every view of each scene, as stored: for validation and evaluation."""

    def __init__(self, split: ShardSplit, channels: Sequence[str]):
        self.split, self.channels = split, tuple(channels)

    def __len__(self) -> int:
        return len(self.split)

    def __getitem__(self, index: int) -> SceneViews:
        sample = self.split.read(index, channels=self.channels)
        return select_views(sample, range(len(sample.fov)), self.channels)
