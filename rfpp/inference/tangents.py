"""Radiosity's inputs as functions of materials: their values, and derivatives to first order.

Light comes out of compiled loops that no gradient passes. It is linear in emission, so its derivative by a light's
emission is the light of that light alone. It is linear in the albedos of the surfaces that rays hit except for multiple
scattering, whose derivative is known, so a record of the rays (`rfpp.raycast.traces`) is its derivative by albedos.
Value + Σ derivative · (parameter - its value) has the right value and derivatives.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from rfpp.inference.materials import MaterialTensors
from rfpp.inference.plan import Plan
from rfpp.inference.radiosity_source import RadiositySource, ViewInputs, as_tensors
from rfpp.radiosity.cell_tensors import CellTensors
from rfpp.radiosity.view import View
from rfpp.raycast.first_hit import DIRECT_CHANNELS, channel
from rfpp.raycast.traces import Trace
from rfpp.scene.triangles import DIFFUSE, ROUGHNESS, SPECULAR

#: Channels that are looked up in materials.
_LOOKED_UP = {"albedo": DIFFUSE, "specular": SPECULAR, "roughness": ROUGHNESS}
#: Channels that are linear in emission.
_LIGHT = (*DIRECT_CHANNELS, "reflected_light")


class DifferentiableInputs:
    """Cells and views of a scene as functions of its materials.

    Args:
        tensors: The scene with materials that are tensors.
        plan: Settings of the render, for the scene of `tensors`.
    """

    def __init__(self, source: RadiositySource, tensors: MaterialTensors, plan: Plan):
        self.source, self.tensors, self.plan = source, tensors, plan
        self.device, self.change = tensors.material.device, change_of(tensors.material)
        powers = {name: float(value.detach().mean()) for name, value in tensors.given["emissive"].items()}
        # white lights of the same power, so that they are sampled as in the scene itself
        self._white = tensors.with_values({(name, "emissive"): power for name, power in powers.items()})
        #: Relative change of each light's red, green and blue, for a white light.
        self.lights = {name: change_of(tensors.given["emissive"][name]) / power for name, power in powers.items()}

    def cells(self) -> CellTensors:
        """Return the cells with derivatives of their albedos and light."""
        cells, sources = self.source.cells(self.tensors.scene.triangles)
        value = CellTensors.of(cells, self.device)
        triangle, cell = (torch.from_numpy(x).long().to(self.device) for x in (sources.triangle, sources.cell))
        sums = self.change.new_zeros(len(value), 10).index_add(0, cell, self.change[triangle])
        mean = sums / cell.bincount(minlength=len(value))[:, None]
        direct, bounced = value.direct, value.bounced + self._by_albedo(sources.bounced)
        for light, change in self.lights.items():
            alone = self.source.cells(self._white.triangles, light)[0]
            direct = direct + torch.from_numpy(alone.direct).to(self.device) * change
            bounced = bounced + torch.from_numpy(alone.bounced).to(self.device) * change
        diffuse, specular = value.diffuse + mean[:, DIFFUSE], value.specular + mean[:, SPECULAR]
        return replace(value, diffuse=diffuse, specular=specular, direct=direct, bounced=bounced).conserving()

    def view(self, number: int, cells: int) -> View:
        """Return a view with derivatives of its channels and bounced light."""
        inputs = self.source.inputs(self.plan, number, traced=True)
        value = as_tensors(inputs, self.tensors.scene, number, cells, self.device)
        channels, bounced = self._with_albedos(inputs, dict(value.channels)), value.bounced
        height, width = bounced.shape[1:]
        bounced = bounced + self._by_albedo(inputs.cells.trace).view(height, width, 3).permute(2, 0, 1)
        for light, change in self.lights.items():
            alone, change = (
                self.source.inputs(replace(self.plan, scene=self._white), number, light),
                change[:, None, None],
            )
            for name in _LIGHT:
                slope = channel(alone.gbuffer, self._white.triangles.material, self._white.fov[number], name)
                channels[name] = channels[name] + self._first(slope) * change
            bounced = bounced + self._first(alone.cells.bounced) * change
        return replace(value, channels=channels, bounced=bounced)

    def _with_albedos(self, inputs: ViewInputs, channels: dict[str, Tensor]) -> dict[str, Tensor]:
        gbuffer = inputs.gbuffer
        hit = torch.from_numpy(gbuffer.hit).to(self.device)
        triangle = torch.from_numpy(gbuffer.triangle).long().to(self.device).clamp_min(0)
        change = (self.change[triangle] * hit[..., None]).permute(2, 0, 1)
        looked_up = {name: channels[name] + change[columns] for name, columns in _LOOKED_UP.items()}
        # multiple scattering multiplies all glossy light, known and gathered, as this channel does
        trace = gbuffer.reflection.trace
        growth = change.new_zeros(*hit.shape, 3)
        growth[hit] = torch.from_numpy(trace.growth).to(self.device)
        tinted = change[SPECULAR] * (1 + channels["specular"] * growth.permute(2, 0, 1))
        by_albedo = change.new_zeros(*hit.shape, 3).index_put((hit,), self._by_albedo(trace)).permute(2, 0, 1)
        return {
            **channels,
            **looked_up,
            "specular": channels["specular"] + tinted,
            "reflected_light": channels["reflected_light"] + by_albedo,
        }

    def _by_albedo(self, trace: Trace) -> Float[Tensor, "r 3"]:
        """Return zeros with the derivatives of the light at R places by the albedos that rays have hit."""
        hit = self.change[torch.from_numpy(trace.triangle).long().to(self.device)]
        by_diffuse, by_specular = (torch.from_numpy(x).to(self.device) for x in (trace.diffuse, trace.specular))
        return (hit[..., DIFFUSE] * by_diffuse + hit[..., SPECULAR] * by_specular).sum(1)

    def _first(self, last: Float[np.ndarray, "h w 3"]) -> Float[Tensor, "3 h w"]:
        return torch.from_numpy(np.ascontiguousarray(np.moveaxis(last, -1, 0))).to(self.device)


def change_of(parameter: Tensor) -> Tensor:
    """Return zeros with the derivative of a parameter."""
    return parameter - parameter.detach()
