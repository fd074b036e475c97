"""Renderer: renders scenes with a trained network or with radiosity."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from rfpp.checkpoint.loading import CHECKPOINT_KEY, CheckpointInfo, load_network
from rfpp.checkpoint.model_card import model_card
from rfpp.checkpoint.model_folder import write_folder
from rfpp.errors import SceneError, UserError
from rfpp.inference.devices import available_device
from rfpp.inference.engine import Engine, Image
from rfpp.inference.network_engine import NetworkEngine
from rfpp.inference.plan import Plan, image_size
from rfpp.inference.radiosity_engine import RadiosityEngine
from rfpp.model.layers.matrix_precision import matrix_dtype
from rfpp.model.renderformer_pp import RenderFormerPP
from rfpp.radiosity.radiosity import Radiosity
from rfpp.scene.io.loading import AnyScene, packed_scene
from rfpp.scene.packed import PackedScene
from rfpp.scene.spec import Camera


class Renderer:
    """Renders scenes with RenderFormer++, RenderFormer or radiosity.

    Example::

        renderer = Renderer.load("radiosity")
        images = renderer.render("data/scenes/cornell_box.json")

    It caches what it has computed of a scene, so that another view costs its own and an edit what it changes. On a CPU
    the image is bit-identical to that of a new renderer. Threads may share it.

    Args:
        module: `RenderFormerPP` or `Radiosity`. Its weights must not change afterwards.
        info: Description from its checkpoint.
        device: Device to run on.
        dtype: Type of matrix products.
    """

    def __init__(
        self,
        module: RenderFormerPP | Radiosity,
        info: CheckpointInfo,
        device: torch.device | str = "cpu",
        dtype: torch.dtype = torch.float32,
    ):
        self.info, self.device, self.dtype = info, torch.device(device), dtype
        if isinstance(module, Radiosity):
            self.engine: Engine = RadiosityEngine(module, self.device, dtype)
        else:
            self.engine = NetworkEngine(module, self.device, dtype)

    @classmethod
    def load(
        cls, checkpoint: Path | str, device: torch.device | str | None = None, precision: str = "auto"
    ) -> Renderer:
        """Load a checkpoint, onto a GPU if there is one.

        Args:
            checkpoint: See `rfpp.checkpoint.loading.load_network`; "radiosity" is included.
            device: Device to run on; None to choose.
            precision: See `rfpp.model.layers.matrix_precision.matrix_dtype`.

        Raises:
            CheckpointError: If it cannot be read, or holds an unknown model.
            UserError: If there is no such precision or device.
        """
        device = available_device(device)
        return cls(*load_network(checkpoint), device, matrix_dtype(precision, device))

    def fresh(self) -> Renderer:
        """Return a renderer of the same model with empty caches."""
        return Renderer(self.engine.module, self.info, self.device, self.dtype)

    def save(
        self, folder: Path | str, metrics: Mapping[str, Mapping[str, float | str]] | None = None, notes: str = ""
    ) -> Path:
        """Write the model as a folder that `load` reads, here or from the hub: safetensors, config and a model card.

        Weights are written as this renderer holds them: load with precision="fp32" to pass them on unrounded.

        Args:
            folder: Folder to write.
            metrics: Row → metric → number for the card, from an evaluation.
            notes: Markdown for the card, for example limitations.

        Raises:
            UserError: If it cannot be written.
        """
        folder, module = Path(folder), self.engine.module
        card = model_card(self.info, sum(p.numel() for p in module.parameters()), folder.name, metrics or {}, notes)
        public = replace(self.info, mlflow_run_id=None, mlflow_tracking_uri=None)  # others have no such store
        return write_folder(folder, {CHECKPOINT_KEY: public.to_dict()}, module.state_dict(), card)

    def render(
        self,
        scene: AnyScene | Sequence[AnyScene],
        resolution: int | tuple[int, int] | None = None,
        cameras: Sequence[Camera] | None = None,
        light_samples: int = 16,
        supersampling: int = 2,
        transports: int | None = None,
    ) -> Float[np.ndarray, "v h w 3"]:
        """Return the linear radiance seen by each camera; of several scenes, one after the other.

        Args:
            scene: Scene to render, or its file, or a list of these.
            resolution: Pixels, a number for square images or (height, width); None is the training resolution.
            cameras: Cameras; None renders the scene's own.
            light_samples: Shadow rays per light and pixel, and rays per pixel into reflections.
            supersampling: Samples along each side of a pixel, for radiosity; light samples are divided among them.
            transports: Applications of the transport operator, or bounces between cells; None is the usual number.

        Raises:
            SceneError: If there is no scene, or no camera.
            UserError: If the resolution does not divide into patches or takes more memory than there is, if there are
                no samples, or if the network has no transport operator to apply.
        """
        sampling = light_samples, supersampling, transports
        if not (scenes := scene if isinstance(scene, list | tuple) else [scene]):
            raise SceneError("the list of scenes is empty: add one")
        return np.stack([image for each in scenes for image in self.views(each, resolution, cameras, *sampling)])

    def views(
        self,
        scene: AnyScene,
        resolution: int | tuple[int, int] | None = None,
        cameras: Sequence[Camera] | None = None,
        light_samples: int = 16,
        supersampling: int = 2,
        transports: int | None = None,
        is_refined: bool = True,
    ) -> Iterator[Image]:
        """Yield the images of `render`, each as soon as it is finished, with or without the refinement."""
        packed = packed_scene(scene)
        packed = packed if cameras is None else packed.seen_by(cameras)
        plan = self.planned(packed, resolution, light_samples, supersampling, transports)
        return self._checked(plan.scene, self.engine.views(plan, is_refined=is_refined))

    def render_lights(
        self, scene: AnyScene, resolution: int | tuple[int, int] | None = None, **sampling: int | None
    ) -> dict[str, Float[np.ndarray, "v h w 3"]]:
        """Return the unrefined images of each light alone, by the name of its object; they add up to the whole.

        Weighted sums of them are the images with lights dimmed, switched off or colored. `refined` turns such a sum
        into the image that `render` returns. Arguments are those of `render`.

        Raises:
            UserError: As for `render`, and for a model that is not linear in lights.
        """
        plan = self.planned(packed_scene(scene), resolution, **sampling)
        self.require_linear("lights")
        alone = {name: self.engine.views(plan, name, False) for name in plan.scene.triangles.light_names}
        return {name: np.stack(list(self._checked(plan.scene, views))) for name, views in alone.items()}

    def render_bounces(
        self, scene: AnyScene, resolution: int | tuple[int, int] | None = None, **sampling: int | None
    ) -> Float[np.ndarray, "n v h w 3"]:
        """Return the unrefined light after one reflection, after two, …; they add up to the whole.

        Arguments are those of `render`.

        Raises:
            UserError: As for `render`, and for a model that is not linear in bounces.
        """
        plan = self.planned(packed_scene(scene), resolution, **sampling)
        engine = self.require_linear("bounces")
        return np.stack(list(self._checked(plan.scene, engine.bounces(plan))), axis=1)

    def refined(
        self, radiance: Float[np.ndarray, "v h w 3"], scene: PackedScene, supersampling: int = 2
    ) -> Float[np.ndarray, "v h w 3"]:
        """Return sums of single lights or bounces, as seen by each of the scene's cameras, after the refinement.

        Raises:
            UserError: For a model that is not linear in lights.
        """
        return self.require_linear("lights").refine(radiance, scene, supersampling)

    def planned(
        self,
        scene: PackedScene,
        resolution: int | tuple[int, int] | None = None,
        light_samples: int = 16,
        supersampling: int = 2,
        transports: int | None = None,
    ) -> Plan:
        """Return the checked settings of a render; arguments and errors as for `render`."""
        if transports is not None and not self.engine.iterations:
            raise UserError(f"transports={transports}: this network has no transport operator: omit it")
        points = supersampling if self.engine.supersamples or supersampling < 1 else 1
        return Plan(scene, self.image_size(resolution), light_samples, points, transports)

    def image_size(self, resolution: int | tuple[int, int] | None) -> tuple[int, int]:
        """Return (height, width) of a requested resolution.

        Raises:
            UserError: If it does not divide into patches.
        """
        return image_size(tuple(self.info.resolution) if resolution is None else resolution, self.engine.patch_size)

    def require_linear(self, parts: str) -> RadiosityEngine:
        """Return the engine if its image is a sum over lights and bounces.

        Raises:
            UserError: If it is not.
        """
        if not isinstance(self.engine, RadiosityEngine):
            raise UserError(f"{parts}: this network's image is not a sum over them: use checkpoint=radiosity")
        return self.engine

    def _checked(self, scene: PackedScene, images: Iterator[np.ndarray]) -> Iterator[np.ndarray]:
        """Yield images that are finite.

        Raises:
            UserError: Naming the likely cause of a pixel that is not.
        """
        for view, image in enumerate(images):
            wrong = np.count_nonzero(~np.isfinite(image).all(axis=-1))
            if wrong and all(torch.isfinite(weight).all() for weight in self.engine.module.parameters()):
                why = "its lights, sizes or camera distance exceed the range of floating point: check the scene"
            else:
                why = "the network's weights are not finite, its training diverged: use an earlier checkpoint"
            if wrong:
                where = f"scene '{scene.name}', view {view}"
                raise UserError(f"{where}: {wrong} of {image.size // 3} pixels are not finite: {why}")
            yield image
