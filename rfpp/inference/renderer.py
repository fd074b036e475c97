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
from rfpp.gbuffer.first_hit import LIGHT_CHANNELS, GBuffer, camera_caster, first_hit, stack_channels
from rfpp.gbuffer.light_sampler import LightSampler
from rfpp.inference.checkpoint import CheckpointInfo, load_network
from rfpp.radiance import log_decode
from rfpp.scene.camera import camera_to_world
from rfpp.scene.spec import Camera, Scene
from rfpp.scene.triangles import SceneTriangles


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
        """Load a checkpoint of launch/train.py, onto a GPU if there is one. Raises CheckpointError."""
        network, info = load_network(checkpoint)
        return cls(network, info, device or ("cuda" if torch.cuda.is_available() else "cpu"))

    def render(
        self,
        scene: Scene,
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
        cameras = scene.cameras if cameras is None else cameras
        if not cameras:
            raise SceneError(f"scene '{scene.name}' has no camera: add one to its `cameras`")
        triangles = SceneTriangles.from_scene(scene)
        c2w = np.stack([camera_to_world(camera) for camera in cameras])
        fov = np.array([camera.fov for camera in cameras], dtype=np.float32)
        gbuffers = cast_views(triangles, c2w, fov, height, width)
        if set(self.network.gbuffer_channels) & set(LIGHT_CHANNELS):
            sampler = LightSampler(triangles)
            views = zip(gbuffers, c2w, fov, strict=True)
            gbuffers = [with_direct_light(g, m, f, sampler, light_samples) for g, m, f in views]
        return self.render_triangles(scene.name, triangles, c2w, fov, gbuffers)

    @torch.inference_mode()
    def render_triangles(
        self,
        key: str,
        triangles: SceneTriangles,
        c2w: Float[np.ndarray, "v 4 4"],
        fov: Float[np.ndarray, " v"],
        gbuffers: Sequence[GBuffer],
    ) -> Float[np.ndarray, "v h w 3"]:
        """The same from packed triangles and G-buffers that are already there. `key` names the scene."""
        channels = self.network.gbuffer_channels
        stacked = [
            stack_channels(g, triangles.material, float(f), channels) for g, f in zip(gbuffers, fov, strict=True)
        ]
        batch = RaggedBatch.pack([SceneViews(key, triangles, c2w, fov, np.stack(stacked))]).to(self.device)
        scene = self.network.encode(batch)
        # one view at a time: the memory of a large image, not of all of them
        images = [
            self.network.view(scene, batch.c2w[:, v : v + 1], batch.fov[:, v : v + 1], batch.gbuffer[:, v : v + 1])
            for v in range(batch.num_views)
        ]
        return log_decode(torch.cat(images, dim=1))[0].permute(0, 2, 3, 1).clamp_min(0).cpu().numpy()

    def image_size(self, resolution: int | tuple[int, int] | None) -> tuple[int, int]:
        """(height, width) of a requested resolution. Raises UserError when it does not divide into patches."""
        if resolution is None:
            resolution = tuple(self.info.resolution)
        height, width = (resolution, resolution) if isinstance(resolution, int) else resolution
        patch = self.network.patch_size
        if min(height, width) < 1 or height % patch or width % patch:
            raise UserError(f"resolution {width} x {height} does not divide into patches of {patch}: use multiples")
        return height, width


def cast_views(
    triangles: SceneTriangles, c2w: Float[np.ndarray, "v 4 4"], fov: Float[np.ndarray, " v"], height: int, width: int
) -> list[GBuffer]:
    """The G-buffer of every camera of one scene, sharing one acceleration structure."""
    caster = camera_caster(triangles)
    return [first_hit(triangles, m, float(f), height, width, caster) for m, f in zip(c2w, fov, strict=True)]
