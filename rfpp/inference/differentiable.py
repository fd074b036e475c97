"""Images with gradients by the materials and lights of a scene, to find these from pictures."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from rfpp.inference.materials import Materials, MaterialTensors
from rfpp.inference.plan import require_memory
from rfpp.inference.renderer import Renderer
from rfpp.inference.tangents import DifferentiableInputs, change_of
from rfpp.radiosity.refinement import Refinement
from rfpp.scene.io.loading import AnyScene, packed_scene
from rfpp.scene.spec import Camera

#: Memory of each sample for the backward pass, measured at 128², 2 × 2 samples a pixel and two albedos.
_BYTES_PER_POINT = 8000
#: Half the step of central differences by roughness.
_STEP = 0.02


class DifferentiableRenderer:
    """Renders as its renderer does, into tensors with gradients by materials of objects.

    Example::

        renderer = DifferentiableRenderer(Renderer.load("radiosity", precision="fp32"))
        color = torch.tensor([0.5, 0.5, 0.5], requires_grad=True)
        image = renderer.render(scene, {"ball": {"diffuse": color}}, resolution=64)
        (image - target).abs().mean().backward()

    Gradients by diffuse and specular albedo and by emission pass through the refinement, through light gathered from
    cells, and through direct light. They are those of the same rays, for any number of objects; each light whose
    emission has a gradient costs one more pass over the rays. Geometry is held fixed, with all that depends on it:
    first hits, directions and ends of rays, and cells.

    Roughness changes directions of rays, so its gradient is a central difference (± 0.02) with the same random numbers:
    two more images for each object whose roughness has a gradient.

    A material whose specular albedo is exactly 0 has no glossy lobe, and no gradient by specular albedo or roughness.

    Args:
        renderer: Renderer of a model that is linear in lights; float32 gives gradients without rounding to bfloat16.
            Its weights are frozen.

    Raises:
        UserError: If the model is not linear in lights.
    """

    def __init__(self, renderer: Renderer):
        self.renderer, self.engine = renderer, renderer.require_linear("gradients")
        self.engine.module.requires_grad_(False)

    def render(
        self,
        scene: AnyScene,
        materials: Materials,
        resolution: int | tuple[int, int] | None = None,
        cameras: Sequence[Camera] | None = None,
        **sampling: int | None,
    ) -> Float[Tensor, "v h w 3"]:
        """Return the linear radiance seen by each camera, equal to that of `Renderer.render` up to rounding.

        Args:
            scene: See `Renderer.render`. Instead of textures it has the colors of triangles.
            materials: Object → property → value in place of the scene's: `diffuse`, `specular` and `emissive` [3] and
                `roughness` [], as in `rfpp.scene.spec.Material`. Values that require a gradient get one.
            resolution: See `Renderer.render`.
            cameras: See `Renderer.render`.
            **sampling: See `Renderer.render`.

        Raises:
            SceneError: As for `Renderer.render`.
            UserError: As for `Renderer.render`, and for an object or property that does not exist or an invalid value.
        """
        packed = packed_scene(scene)
        packed = packed if cameras is None else packed.seen_by(cameras)
        tensors = MaterialTensors.of(packed, materials, self.renderer.device)
        plan = self.renderer.planned(tensors.scene, resolution, **sampling)
        require_memory(*plan.size, plan.points, len(packed.fov) * _BYTES_PER_POINT)
        inputs = DifferentiableInputs(self.engine.source, tensors, plan)
        cells = inputs.cells()
        lit = self.engine.module.solve(cells, plan.transports)[-1]
        images = []
        for number in range(len(packed.fov)):
            view = inputs.view(number, len(cells))
            radiance = self.engine.module.render(lit, view)
            refined = self.engine.module.refine(radiance, view.pixels(Refinement.channels), view.fov)
            images.append(refined.permute(1, 2, 0).clamp_min(0))
        image = torch.stack(images)
        for name, value in tensors.given["roughness"].items():
            low, high = max(value.item() - _STEP, 0.0), min(value.item() + _STEP, 1.0)
            less, more = (
                self.renderer.render(tensors.with_values({(name, "roughness"): there}), resolution, **sampling)
                for there in (low, high)
            )
            image = image + torch.from_numpy((more - less) / (high - low)).to(image) * change_of(value)
        return image
