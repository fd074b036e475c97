"""The rival that learns nothing: radiosity between cells, added to the light that is known."""

from __future__ import annotations

import torch
from torch import nn

from rfpp.batch import RaggedBatch
from rfpp.imaging.radiance import log_encode
from rfpp.model.bounces import light_after
from rfpp.model.cell_gathering import EvenGathering
from rfpp.model.form_factors import CastFormFactors
from rfpp.model.joint_window import JointWindow
from rfpp.model.linear_decoder import KNOWN, radiance_with
from rfpp.model.lit_cells import LitCells, Reflectance
from rfpp.model.pixel_filter import PixelFilter
from rfpp.model.renderformer_pp import Rendering
from rfpp.model.view_channels import ViewChannels


class UnlearnedRadiosity(nn.Module):
    """Everything of a network that is linear in light but what it learns; to be read beside every learned result.

    Light passes between cells as their rays say, and pixels gather what theirs bring.

    Args:
        iterations: bounces between cells.
    """

    name = "unlearned radiosity"
    #: As a network has it.
    patch_size = 1

    def __init__(self, iterations: int = 8):
        super().__init__()
        self.iterations, self.form_factors, self.film = iterations, CastFormFactors(), PixelFilter(0.125)
        self.gathering = EvenGathering(JointWindow())

    @property
    def gbuffer_channels(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys([*self.gathering.channels, *KNOWN]))

    def forward(self, batch: RaggedBatch, supersampling: int = 1) -> Rendering:
        """Raises ValueError where the batch does not carry cells."""
        if batch.cells is None:
            raise ValueError("radiosity moves light between cells, but the batch carries none")
        cells, (scenes, views, _, *size) = batch.cells, batch.gbuffer.shape
        height, width = (points // supersampling for points in size)
        reflectance = Reflectance(cells.diffuse, cells.specular).bounded(1.0)
        bounce = self.form_factors.bounce(cells, reflectance)
        states = light_after(cells.arriving, bounce, self.iterations)
        before = (torch.zeros_like(states[0]), *states)[self.iterations]
        lit = LitCells(cells, cells.area[:, None], reflectance, states[0], states[-1], before)
        unit = torch.ones(scenes * views, device=batch.gbuffer.device)
        of_points = ViewChannels(batch.gbuffer.flatten(0, 1), self.gbuffer_channels, unit)
        channels = of_points.pooled(supersampling).linear(self.gathering.channels)
        radiance = radiance_with(lambda shared: self.gathering(channels, lit, shared), of_points, supersampling)
        image = self.film(radiance, supersampling).view(scenes, views, 3, height, width)
        return Rendering(log_encode(image), states[1:], cells.scenes, cells.scenes)
