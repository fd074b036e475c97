"""Rendering with radiosity."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from jaxtyping import Float

from rfpp.inference.plan import Plan
from rfpp.inference.radiosity_source import RadiositySource, as_tensors
from rfpp.radiosity.cell_tensors import CellTensors, LitCells
from rfpp.radiosity.radiosity import Radiosity
from rfpp.radiosity.refinement import Refinement
from rfpp.radiosity.sample_means import means
from rfpp.radiosity.view import View
from rfpp.raycast.first_hit import stack_channels
from rfpp.scene.packed import PackedScene

Image = Float[np.ndarray, "h w 3"]
#: Bounces that a viewer offers to look at; a scene takes as many as it needs.
_SHOWN_BOUNCES = 8


class RadiosityEngine:
    """Engine of radiosity; see `rfpp.inference.engine.Engine`.

    It caches cells, acceleration structures and first hits, so that another view or an edit recomputes only changes.

    Args:
        radiosity: Solver and refinement; the refinement's weights must not change afterwards.
        dtype: Type of the refinement's matrix products.
    """

    is_linear, supersamples, patch_size = True, True, 1

    def __init__(self, radiosity: Radiosity, device: torch.device, dtype: torch.dtype):
        self.module = radiosity.to(device).eval()
        self.device, self.dtype, self.iterations = device, dtype, _SHOWN_BOUNCES
        self.source = RadiositySource()

    def views(self, plan: Plan, light: str | None = None, is_refined: bool = True) -> Iterator[Image]:
        """Yield the linear radiance of each camera; see `Engine.views`."""
        lit = self._solve(plan, light)[-1]
        for number in range(len(plan.scene.fov)):
            view = self._view(plan, number, light, len(lit.cells))
            with torch.inference_mode():
                radiance = self.module.render(lit, view)
                if is_refined:
                    radiance = self._refined(radiance, view.pixels(Refinement.channels), view.fov)
                yield _as_image(radiance)

    def bounces(self, plan: Plan) -> Iterator[Float[np.ndarray, "n h w 3"]]:
        """Yield for each camera the unrefined light after one reflection, after two, …, which add up to the image."""
        states = self._solve(plan, None)
        for number in range(len(plan.scene.fov)):
            view = self._view(plan, number, None, len(states[0].cells))
            with torch.inference_mode():
                direct = self.module.render(states[0], view.direct_only(len(states[0].cells)))
                sums = [direct, *(self.module.render(lit, view) for lit in states)]
                after = np.stack([_as_image(radiance) for radiance in sums])
            yield np.diff(after, axis=0, prepend=np.float32(0)).clip(0)

    @torch.inference_mode()
    def refine(self, radiance: Float[np.ndarray, "v h w 3"], scene: PackedScene, points: int) -> np.ndarray:
        """Return refined images of all the scene's cameras, from sums of single lights or bounces.

        Args:
            radiance: Linear radiance, unrefined.
            points: Samples along each side of a pixel for the G-buffer.
        """
        images = []
        for number, image in enumerate(radiance):
            gbuffer = self.source.gbuffers.first_hit(scene, number, *image.shape[:2], points)
            surfaces = stack_channels(gbuffer, scene.triangles.material, scene.fov[number], Refinement.channels)
            linear = torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1))).to(self.device)
            pixels = means(torch.from_numpy(surfaces)[None].to(self.device), points)
            images.append(_as_image(self._refined(linear, pixels, float(scene.fov[number]))))
        return np.stack(images)

    def _solve(self, plan: Plan, light: str | None) -> list[LitCells]:
        cells, _ = self.source.cells(plan.scene.triangles, light)
        with torch.inference_mode():
            return self.module.solve(CellTensors.of(cells, self.device), plan.transports)

    def _view(self, plan: Plan, number: int, light: str | None, cells: int) -> View:
        inputs = self.source.inputs(plan, number, light)
        return as_tensors(inputs, plan.scene, number, cells, self.device)

    def _refined(self, radiance: torch.Tensor, surfaces: torch.Tensor, fov: float) -> torch.Tensor:
        with torch.autocast(self.device.type, self.dtype, enabled=self.dtype != torch.float32):
            return self.module.refine(radiance, surfaces, fov)


def _as_image(radiance: torch.Tensor) -> Image:
    return radiance.permute(1, 2, 0).clamp_min(0).cpu().numpy()
