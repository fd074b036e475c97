"""Known light as a function of materials: its value, and to first order how it changes with them.

Known light comes out of compiled loops that no gradient passes. But it is linear in what lights emit, so its derivative
by that is the light of one light alone; and it is linear in the albedos of what its rays meet but for multiple
scattering, whose derivative is known, so a record of the rays (`rfpp.gbuffer.traces`) is its derivative by these.
Value + Σ derivative · (parameter - its value) is the value, and has these derivatives.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from rfpp.gbuffer.first_hit import BOUNCED_LIGHT, LIGHT_CHANNELS, GBuffer, channel, stack_channels
from rfpp.gbuffer.traces import Trace
from rfpp.inference.gbuffers import GBufferSource
from rfpp.inference.materials import MaterialTensors
from rfpp.model.view_channels import channel_sizes
from rfpp.packed_cells import PackedCells
from rfpp.scene.packed import PackedScene
from rfpp.scene.triangles import DIFFUSE, ROUGHNESS, SPECULAR

#: Channels that are looked up in materials.
_LOOKED_UP = {"albedo": DIFFUSE, "specular": SPECULAR, "roughness": ROUGHNESS}
#: Light of cells that changes with materials.
_OF_CELLS = ("arriving", "highlights")


class KnownLight:
    """What networks are given of a scene beside its triangles, as a function of its materials.

    Args:
        source: of the network.
        tensors: the scene.
        cast: scene, light, traced → view number → its G-buffer.
    """

    def __init__(
        self,
        source: GBufferSource,
        tensors: MaterialTensors,
        cast: Callable[[PackedScene, str | None, bool], Callable[[int], GBuffer]],
    ):
        self.source, self.tensors, self.cast = source, tensors, cast
        self.device, self.amount = tensors.material.device, amount_of(tensors.material)
        powers = {name: float(value.detach().mean()) for name, value in tensors.given["emissive"].items()}
        #: The scene with lights in white, of the power they have: so they are sampled as in the scene itself.
        self.white = tensors.with_values({(name, "emissive"): power for name, power in powers.items()})
        #: Of lights: relative changes of their red, green and blue in white.
        self.lights = {name: amount_of(tensors.given["emissive"][name]) / power for name, power in powers.items()}

    def cells(self, value: PackedCells) -> PackedCells:
        """Cells with the derivatives of their reflectances and light.

        Args:
            value: of the scene alone, on the device of the tensors.
        """
        device, triangles = value.area.device, self.tensors.scene.triangles
        sources = self.source.cell_sources(triangles)
        triangle, cell = (torch.from_numpy(x).long().to(device) for x in (sources.triangle, sources.cell))
        sums = self.amount.new_zeros(len(value), 10).index_add(0, cell, self.amount[triangle])
        mean = sums / cell.bincount(minlength=len(value))[:, None]
        changed = {
            "diffuse": value.diffuse + mean[:, DIFFUSE],
            "specular": value.specular + mean[:, SPECULAR],
            "roughness": value.roughness + mean[:, ROUGHNESS][:, 0],
            "arriving": value.arriving,
            "highlights": value.highlights + self._by_albedo(sources.highlights),
        }
        for light, amount in self.lights.items():
            alone = self.source.known_of_scene(self.white.triangles, ("cells",), light)["cells"]
            for name in _OF_CELLS:
                changed[name] = changed[name] + torch.from_numpy(getattr(alone, name)).to(device) * amount
        return replace(value, **changed)

    def channels(self, view: int) -> Float[Tensor, "c h w"]:
        """The channels of a view, with their derivatives."""
        scene, device, names = self.tensors.scene, self.device, self.source.channels
        gbuffer = self.cast(scene, None, True)(view)
        stacked = stack_channels(gbuffer, scene.triangles.material, scene.fov[view], names)
        values = {name: torch.from_numpy(x).to(device) for name, x in _split(stacked, names).items()}
        hit = torch.from_numpy(gbuffer.hit).to(device)
        met = torch.from_numpy(gbuffer.triangle).long().to(device).clamp_min(0)
        amount = (self.amount[met] * hit[..., None]).permute(2, 0, 1)
        changed = {name: values[name] + amount[columns] for name, columns in _LOOKED_UP.items() if name in values}
        if gbuffer.reflection is not None:
            trace = gbuffer.reflection.trace
            # what colours multiple scattering multiplies all glossy light, known and gathered, as this channel does
            growth = values["specular"].new_zeros(*hit.shape, 3)
            growth[hit] = torch.from_numpy(trace.growth).to(device)
            tinted = amount[SPECULAR] * (1 + values["specular"] * growth.permute(2, 0, 1))
            changed["specular"] = values["specular"] + tinted
            by_albedo = self.amount.new_zeros(*hit.shape, 3)
            by_albedo = by_albedo.index_put((hit,), self._by_albedo(trace))
            changed["reflected_light"] = values["reflected_light"] + by_albedo.permute(2, 0, 1)
        if gbuffer.cells is not None:
            by_albedo = self._by_albedo(gbuffer.cells.trace)
            points = round((hit.numel() / len(by_albedo)) ** 0.5)
            of_pixels = by_albedo.view(hit.shape[0] // points, hit.shape[1] // points, 3).permute(2, 0, 1)
            spread = of_pixels.repeat_interleave(points, 1).repeat_interleave(points, 2)
            changed[BOUNCED_LIGHT] = values[BOUNCED_LIGHT] + spread
        for light, amount in self.lights.items():
            alone = self.cast(self.white, light, False)(view)
            for name in filter(LIGHT_CHANNELS.__contains__, names):
                of_light = channel(alone, self.white.triangles.material, self.white.fov[view], name)
                slope = torch.from_numpy(np.moveaxis(of_light, -1, 0)).to(device)
                changed[name] = changed.get(name, values[name]) + slope * amount[:, None, None]
        return torch.cat([changed.get(name, values[name]) for name in names])

    def _by_albedo(self, trace: Trace) -> Float[Tensor, "r 3"]:
        """Zeros, with the derivatives of the light at R places by the albedos of what rays have met."""
        device = self.amount.device
        met = self.amount[torch.from_numpy(trace.triangle).long().to(device)]
        by_diffuse, by_specular = (torch.from_numpy(x).to(device) for x in (trace.diffuse, trace.specular))
        return (met[..., DIFFUSE] * by_diffuse + met[..., SPECULAR] * by_specular).sum(1)


def amount_of(parameter: Tensor) -> Tensor:
    """Zeros that change as a parameter does."""
    return parameter - parameter.detach()


def _split(stacked: Float[np.ndarray, "c h w"], names: Sequence[str]) -> Mapping[str, Float[np.ndarray, "_ h w"]]:
    places = np.cumsum(channel_sizes(names, len(stacked)))[:-1]
    return dict(zip(names, np.split(stacked, places), strict=True))
