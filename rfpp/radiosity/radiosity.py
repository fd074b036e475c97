"""Radiosity: direct light, mirror reflections and light exchanged between cells, gathered by each pixel."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from rfpp.radiosity.cell_tensors import CellTensors, LitCells, lit_directly, of_rays
from rfpp.radiosity.joint_window import JointWindow
from rfpp.radiosity.refinement import Refinement
from rfpp.radiosity.sample_means import means, repeated
from rfpp.radiosity.view import View

#: Share of each neighbor along a row and along a column in a pixel of one sample. G-buffers have hard edges,
#: path-traced images do not.
_PIXEL_FILTER = 0.125

#: Share of light that may be missing, and the bounces after which to stop in any case.
_REMAINING, _MOST_BOUNCES = 1e-3, 256


class Radiosity(nn.Module):
    """Ray-cast radiosity, and a U-Net that refines the finished image.

    The unrefined image is linear in the scene's lights and in each of its bounces.

    Light moves between cells until little of it is left; the number of bounces depends on geometry and albedos alone,
    so that images of several lights are sums.

    Args:
        refinement: Correction of finished images; None leaves them as they are.
    """

    #: G-buffer channels that a view must carry.
    gbuffer_channels = (
        "albedo", "specular", "roughness", "normal", "position", "direct_diffuse", "direct_glossy", "reflected_light",
    )  # fmt: skip

    def __init__(self, refinement: Refinement | None = None):
        super().__init__()
        self.window, self.refinement = JointWindow(), refinement

    def solve(self, cells: CellTensors, bounces: int | None = None) -> list[LitCells]:
        """Return the cells after 0, 1, … bounces.

        Args:
            bounces: Number of bounces; None for as many as the scene needs.
        """
        lit = [lit_directly(cells)]
        for _ in range(_bounces_of(cells) if bounces is None else bounces):
            lit.append(lit[-1].bounced())
        return lit

    def render(self, lit: LitCells, view: View) -> Float[Tensor, "3 h w"]:
        """Return the linear radiance of a view, unrefined."""
        roughness, reflected = view.samples("roughness"), view.samples("reflected_light")
        # few rays of a broad lobe are noisy, so neighbors share them; a mirror's image stays sharp
        shared = means((roughness * reflected)[None], view.points)
        gathered = repeated(self._gathered(lit, view, shared), view.points)[0]
        diffuse = view.samples("direct_diffuse") + gathered[:3]
        glossy = view.samples("direct_glossy") + (1 - roughness) * reflected + gathered[3:]
        radiance = view.samples("albedo") * diffuse + view.samples("specular") * glossy
        return _filtered(means(radiance[None], view.points), view.points)[0]

    def refine(
        self, radiance: Float[Tensor, "3 h w"], surfaces: Float[Tensor, "1 13 h w"], fov: float
    ) -> Float[Tensor, "3 h w"]:
        """Return the image after the refinement, if there is one.

        Args:
            radiance: Linear radiance.
            fov: Full angle in degrees along the longer image side.
        """
        if self.refinement is None:
            return radiance
        refined: Tensor = self.refinement(radiance[None], surfaces, torch.tensor([fov], device=radiance.device))
        return refined[0]

    def _gathered(self, lit: LitCells, view: View, shared: Float[Tensor, "1 3 h w"]) -> Float[Tensor, "1 6 h w"]:
        """Return indirect light of the diffuse and the glossy lobe, shared among similar neighboring pixels."""
        diffuse = lit.toward(view.diffuse, view.diffuse_onward).mean(0).permute(2, 0, 1) + view.bounced
        glossy = lit.toward(view.glossy, view.glossy_onward).mean(0).permute(2, 0, 1)
        gathered = torch.cat([diffuse[None], glossy[None] + shared], dim=1)
        return self.window(gathered, view.pixels(JointWindow.channels))


@torch.no_grad()
def _bounces_of(cells: CellTensors) -> int:
    """Return the number of bounces after which a bounce adds less than a thousandth of the light so far."""
    left = torch.ones_like(cells.diffuse)
    total, albedo = left.sum(), cells.diffuse + cells.specular
    for bounces in range(_MOST_BOUNCES):
        left = of_rays(albedo * left, cells.hits).mean(1)
        total = total + left.sum()
        if left.sum() <= _REMAINING * total:
            return bounces + 1
    return _MOST_BOUNCES


def _filtered(radiance: Float[Tensor, "n 3 h w"], points: int) -> Float[Tensor, "n 3 h w"]:
    """Blur slightly, as the pixel filter of path-traced images does; less for pixels of several samples."""
    share = _PIXEL_FILTER / points
    x = F.pad(radiance, (1, 1, 1, 1), mode="replicate")
    x = share * (x[..., :-2, :] + x[..., 2:, :]) + (1 - 2 * share) * x[..., 1:-1, :]
    return share * (x[..., :-2] + x[..., 2:]) + (1 - 2 * share) * x[..., 1:-1]
