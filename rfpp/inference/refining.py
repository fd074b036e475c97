"""The last stage of a network alone, for images that were put together of parts."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager

import numpy as np
import torch
from jaxtyping import Float

from rfpp.inference.gbuffers import GBufferSource
from rfpp.model.points import means
from rfpp.model.renderformer_pp import RenderFormerPP
from rfpp.scene.packed import PackedScene


class Refiner:
    """Refines sums of images of single lights or bounces as `Renderer.render` refines whole ones.

    Args:
        network: in evaluation mode, on `device`.
        autocast: of matrix products.
    """

    def __init__(self, network: RenderFormerPP, device: torch.device, autocast: Callable[[], AbstractContextManager]):
        self.network, self.device, self.autocast = network, device, autocast
        self._surfaces = GBufferSource(network.refinement.channels)

    @torch.inference_mode()
    def __call__(
        self, radiance: Float[np.ndarray, "v h w 3"], scene: PackedScene, supersampling: int = 2
    ) -> Float[np.ndarray, "v h w 3"]:
        """The refined images; the same where the network has no refinement.

        Args:
            radiance: linear, of all the scene's cameras.
            supersampling: see `Renderer.render`.
        """
        if not self.network.refinement.channels:
            return radiance
        points = supersampling if self.network.shades_points else 1
        surfaces = self._surfaces.of(scene, *radiance.shape[1:3], light_samples=1, points=points)
        return np.stack([self._one(image, surfaces(view), scene.fov[view]) for view, image in enumerate(radiance)])

    def _one(
        self, image: Float[np.ndarray, "h w 3"], surfaces: Float[np.ndarray, "c height width"], fov: np.floating
    ) -> Float[np.ndarray, "h w 3"]:
        seen = torch.from_numpy(surfaces)[None].to(self.device)
        seen = means(seen, seen.shape[-1] // image.shape[1])
        radiance = torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1)))[None].to(self.device)
        with self.autocast():
            refined = self.network.refinement(radiance, seen, torch.tensor([fov], device=self.device))
        return refined[0].permute(1, 2, 0).cpu().numpy()
