"""Images that can be differentiated by the materials and lights of a scene: for finding them from pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from rfpp.errors import UserError
from rfpp.imaging.radiance import log_decode
from rfpp.inference.materials import Materials, MaterialTensors
from rfpp.inference.memory import require_memory
from rfpp.inference.plan import Plan
from rfpp.inference.renderer import Renderer
from rfpp.inference.tangents import KnownLight, amount_of
from rfpp.model.renderformer_pp import EncodedScenes
from rfpp.model.tokenizer import SceneTokens
from rfpp.scene.packed import PackedScene, pack
from rfpp.scene.spec import Camera, Scene

#: Of each point that is shaded, for the way back: rfpp-tiny takes 4,400 at 128², 2 × 2 points a pixel and two albedos.
_BYTES_PER_POINT = 8000
#: Half the step of differences by roughness.
_STEP = 0.02


class DifferentiableRenderer:
    """Renders as its renderer does, into tensors with gradients by materials of objects.

        renderer = DifferentiableRenderer(Renderer.load("rfpp-tiny", precision="fp32"))
        colour = torch.tensor([0.5, 0.5, 0.5], requires_grad=True)
        image = renderer.render(scene, {"ball": {"diffuse": colour}}, resolution=64)
        (image - target).abs().mean().backward()

    Gradients by diffuse and specular albedo and by emission pass through the network, through light that is gathered
    from cells, and through known light. They are those of the same rays, whatever the number of objects; each light
    whose emission is asked for is one more pass over the rays. Geometry and all that depends on it are held fixed: what
    is seen, where rays go and end, and which cells there are.

    Roughness changes where rays go, so by roughness the image has a central difference (± 0.02) with the same random
    numbers: two more images for each object whose roughness is asked for.

    A material whose specular albedo is exactly 0 has no glossy lobe, and no gradient by specular albedo or roughness.
    Not in the paper.

    Args:
        renderer: of a network that is linear in lights; float32 gives gradients without the rounding of bfloat16. Its
            weights are frozen.

    Raises:
        UserError: the network is not linear in lights.
    """

    def __init__(self, renderer: Renderer):
        if not renderer.network.linear_in_lights:
            raise UserError("gradients: this network's known light has none: use one of linear light")
        self.renderer = renderer
        renderer.network.requires_grad_(False)

    def render(
        self,
        scene: Scene | PackedScene,
        materials: Materials,
        resolution: int | tuple[int, int] | None = None,
        cameras: Sequence[Camera] | None = None,
        **sampling: int | None,
    ) -> Float[Tensor, "v h w 3"]:
        """Linear radiance seen by each camera, the numbers of `Renderer.render` to rounding, on its device.

        Args:
            materials: object → property → value in place of the scene's: `diffuse`, `specular` and `emissive` [3] and
                `roughness` [], as `rfpp.scene.spec.Material` has them. There are gradients by those that ask for them.
            resolution, cameras, sampling: see `Renderer.render`.

        Raises:
            SceneError, UserError: like `Renderer.render`; for an object or property that does not exist, geometry among
                them, and for a value that is none of it.
        """
        packed = pack(scene) if cameras is None else pack(scene).seen_by(cameras)
        tensors = MaterialTensors.of(packed, materials, self.renderer.device)
        plan = self.renderer.planned(tensors.scene, resolution, **sampling)
        require_memory(*plan.size, plan.points, len(packed.fov) * _BYTES_PER_POINT)

        def cast(scene: PackedScene, light: str | None, traced: bool):
            size = (plan.points * side for side in plan.size)
            return self.renderer.gbuffers.seen(scene, *size, plan.samples, plan.points, light, traced)

        known = KnownLight(self.renderer.gbuffers, tensors, cast)
        with self.renderer.encoder.autocast():
            encoded = self._encoded(tensors, known, plan)
            views = [self._view(encoded, known.channels(view), packed, view, plan) for view in range(len(packed.fov))]
        image = torch.stack(views)
        for name, value in tensors.given["roughness"].items():
            low, high = max(value.item() - _STEP, 0.0), min(value.item() + _STEP, 1.0)
            less, more = (
                self.renderer.render(tensors.with_values({(name, "roughness"): there}), resolution, **sampling)
                for there in (low, high)
            )
            image = image + torch.from_numpy((more - less) / (high - low)).to(image) * amount_of(value)
        return image

    def _encoded(self, tensors: MaterialTensors, known: KnownLight, plan: Plan) -> EncodedScenes:
        """Objects without gradients are those that the renderer knows."""
        renderer, network = self.renderer, self.renderer.network
        on_host = renderer.batch(tensors.scene)
        batch = on_host.to(renderer.device)
        batch = replace(batch, material=tensors.material, cells=known.cells(batch.cells))
        exposure = network.exposure(batch).detach()  # which divides all light, and multiplies the image
        batch = batch.dimmed(exposure)
        if renderer.objects is None:
            tokens = network.tokens(batch)
        else:
            with torch.no_grad():
                parts = renderer.objects.each(on_host.dimmed(exposure.cpu()))
            for number in tensors.changing:
                parts[number] = network.tokens(batch.only([number]))
            tokens = SceneTokens.joined(parts, batch.scenes.lengths)
        tokens = network.source(tokens, batch)
        if plan.transports is None:
            return network.transported(exposure, tokens)
        return network.transported_each(exposure, tokens, plan.transports)[0][-1]

    def _view(
        self, encoded: EncodedScenes, channels: Float[Tensor, "c h w"], scene: PackedScene, view: int, plan: Plan
    ) -> Float[Tensor, "height width 3"]:
        device = self.renderer.device
        camera = (torch.from_numpy(x[view : view + 1][None]).to(device) for x in (scene.c2w, scene.fov))
        log_radiance = self.renderer.network.view(encoded, *camera, channels[None, None], plan.points, plan.stride)
        return log_decode(log_radiance)[0, 0].permute(1, 2, 0).clamp_min(0)
