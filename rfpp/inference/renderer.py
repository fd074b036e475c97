"""Renderer: a trained network as something to render scenes with."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import nn

from rfpp.batch import RaggedBatch, SceneViews
from rfpp.errors import SceneError, UserError
from rfpp.gbuffer.direct_light import with_direct_light
from rfpp.gbuffer.first_hit import LIGHT_CHANNELS, camera_caster, first_hit, stack_channels
from rfpp.gbuffer.light_sampler import LightSampler
from rfpp.inference.checkpoint import CheckpointInfo, load_network
from rfpp.radiance import log_decode
from rfpp.scene.packed import PackedScene, pack
from rfpp.scene.spec import Camera, Scene


class Renderer:
    """Renders scenes with a trained network.

        renderer = Renderer.load("data/runs/quickstart/latest/checkpoints/best.ckpt")
        images = renderer.render(Scene.load("data/scenes/cornell_box.json"))

    Args:
        network: RaggedBatch → Rendering, in evaluation mode.
        info: what its checkpoint says about it.
        device: where to run.
    """

    def __init__(self, network: nn.Module, info: CheckpointInfo, device: torch.device | str = "cpu"):
        self.network, self.info, self.device = network.to(device).eval(), info, torch.device(device)

    @classmethod
    def load(cls, checkpoint: Path | str, device: torch.device | str | None = None) -> Renderer:
        """Load a checkpoint, onto a GPU if there is one.

        Args:
            checkpoint: see `rfpp.inference.checkpoint.load_network`.

        Raises:
            CheckpointError: it cannot be read, or is not of a network we know.
        """
        network, info = load_network(checkpoint)
        return cls(network, info, device or ("cuda" if torch.cuda.is_available() else "cpu"))

    @torch.inference_mode()
    def render(
        self,
        scene: Scene | PackedScene,
        resolution: int | tuple[int, int] | None = None,
        cameras: Sequence[Camera] | None = None,
        light_samples: int = 16,
    ) -> Float[np.ndarray, "v h w 3"]:
        """Linear radiance seen by each camera; the scene is encoded once for all of them.

        Args:
            scene: what to render.
            resolution: pixels, a number for square images or (height, width); None is the training resolution.
            cameras: None renders the scene's own.
            light_samples: shadow rays per light and pixel, for networks that are given the direct light.

        Raises:
            SceneError: there is no camera.
            UserError: the resolution does not divide into the network's patches.
        """
        height, width = self.image_size(resolution)
        packed = pack(scene) if cameras is None else pack(scene).seen_by(cameras)
        if not len(packed.fov):
            raise SceneError(f"scene '{packed.name}' has no camera: add one to its `cameras`")
        gbuffers = self._gbuffers(packed, height, width, light_samples)
        views = SceneViews(packed.name, packed.triangles, packed.c2w, packed.fov, gbuffers, texture=packed.texture)
        batch = RaggedBatch.pack([views]).to(self.device)
        encoded = self.network.encode(batch)
        # one view at a time: the memory of a large image, not of all of them
        images = [
            self.network.view(encoded, batch.c2w[:, v : v + 1], batch.fov[:, v : v + 1], batch.gbuffer[:, v : v + 1])
            for v in range(batch.num_views)
        ]
        return log_decode(torch.cat(images, dim=1))[0].permute(0, 2, 3, 1).clamp_min(0).cpu().numpy()

    def _gbuffers(
        self, scene: PackedScene, height: int, width: int, light_samples: int
    ) -> Float[np.ndarray, "v c h w"]:
        """The channels the network asks for; no ray is cast for a network that asks for none."""
        channels = self.network.gbuffer_channels
        if not channels:
            return np.zeros((len(scene.fov), 0, height, width), np.float32)
        triangles, caster = scene.triangles, camera_caster(scene.triangles)
        sampler = LightSampler(triangles) if set(channels) & set(LIGHT_CHANNELS) else None
        stacked = []
        for c2w, fov in zip(scene.c2w, scene.fov, strict=True):
            gbuffer = first_hit(triangles, c2w, fov, height, width, caster)
            if sampler:
                gbuffer = with_direct_light(gbuffer, c2w, fov, sampler, light_samples)
            stacked.append(stack_channels(gbuffer, triangles.material, fov, channels))
        return np.stack(stacked)

    def image_size(self, resolution: int | tuple[int, int] | None) -> tuple[int, int]:
        """(height, width) of a requested resolution. Raises UserError when it does not divide into patches."""
        if resolution is None:
            resolution = tuple(self.info.resolution)
        height, width = (resolution, resolution) if isinstance(resolution, int) else resolution
        patch = self.network.patch_size
        if min(height, width) < 1 or height % patch or width % patch:
            raise UserError(f"resolution {width} x {height} does not divide into patches of {patch}: use multiples")
        return height, width
