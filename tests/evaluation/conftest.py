"""A data set whose every image is half its albedo, and networks whose answers are known."""

from pathlib import Path

import numpy as np
import pytest
import torch
from known_scenes import look_at, still_life
from torch import nn

from rfpp.gbuffer.direct_light import with_direct_light
from rfpp.gbuffer.first_hit import first_hit, stack_channels
from rfpp.gbuffer.light_sampler import LightSampler
from rfpp.model.renderformer_pp import Rendering
from rfpp.radiance import log_encode
from rfpp.shards.manifest import MANIFEST_FILE, manifest_json
from rfpp.shards.sample import SceneSample, encode
from rfpp.shards.tar import pack
from rfpp.shards.writer import ShardWriter, write_json

SIZE = 16
POSES = [look_at((0.9, 0.2, 0.9)), look_at((-0.3, -1.0, 0.8))]


def _sample(key: str, seed: int, brightness: float) -> SceneSample:
    triangles = still_life(seed)
    sampler = LightSampler(triangles)
    gbuffers = tuple(
        with_direct_light(first_hit(triangles, pose, 45.0, SIZE, SIZE), pose, 45.0, sampler, samples=1)
        for pose in POSES
    )
    albedo = [stack_channels(g, triangles.material, 45.0, ["albedo"]).transpose(1, 2, 0) for g in gbuffers]
    return SceneSample(
        key=key,
        triangles=triangles,
        c2w=np.stack(POSES).astype(np.float32),
        fov=np.full(len(POSES), 45.0, np.float32),
        images=(brightness * np.stack(albedo)).astype(np.float16).astype(np.float32),
        gbuffers=gbuffers,
        meta={},
    )


def _write_split(root: Path, split: str, brightness: list[float]):
    writer = ShardWriter(root, f"{split}-00000.tar", "fingerprint")
    for index, level in enumerate(brightness):
        key = f"{split}-{index:06d}"
        blocks = pack(key, encode(_sample(key, index, level)))
        writer.add(key, blocks, triangles=100, objects=5, scene_redraws=0, camera_redraws=0)
    return writer.commit()


@pytest.fixture(scope="session")
def data_root(tmp_path_factory) -> Path:
    """Training images are 0.5 albedo; the test scenes 0.5, 0.6 and 0.9 albedo."""
    root = tmp_path_factory.mktemp("known-data")
    levels = {"train": [0.5, 0.5], "test": [0.6, 0.5, 0.9]}
    splits = {split: [_write_split(root, split, values)] for split, values in levels.items()}
    write_json(root / MANIFEST_FILE, manifest_json("known", {}, len(POSES), splits))
    return root


class HalfAlbedo(nn.Module):
    """A network that predicts half the albedo, and checks that it is given what it asked for."""

    gbuffer_channels = ("roughness", "albedo")
    patch_size = 4

    def forward(self, batch) -> Rendering:
        assert batch.gbuffer.shape[2] == 4
        return Rendering(log_encode(0.5 * batch.gbuffer[:, :, 1:4]), ())


@pytest.fixture
def half_albedo() -> nn.Module:
    return HalfAlbedo()


@pytest.fixture
def cpu() -> torch.device:
    return torch.device("cpu")
