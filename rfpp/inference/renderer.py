"""Renderer: a trained network as something to render scenes with."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from rfpp.batch import RaggedBatch, SceneViews
from rfpp.checkpoint.loading import CHECKPOINT_KEY, CheckpointInfo, load_network
from rfpp.checkpoint.model_card import model_card
from rfpp.checkpoint.model_folder import write_folder
from rfpp.errors import UserError
from rfpp.imaging.radiance import log_decode
from rfpp.inference.gbuffers import GBufferSource, direct_alone
from rfpp.inference.plan import Plan, image_size
from rfpp.inference.refining import Refiner
from rfpp.inference.scene_encoder import SceneEncoder
from rfpp.model.matrix_precision import convert_blocks, matrix_dtype
from rfpp.model.renderformer_pp import EncodedScenes
from rfpp.scene.packed import PackedScene, pack
from rfpp.scene.spec import Camera, Scene

#: A camera's c2w and fov, and the channels that it sees.
View = tuple[Float[Tensor, "1 1 4 4"], Float[Tensor, "1 1"], Float[np.ndarray, "c h w"]]
Encoded = TypeVar("Encoded")


class Renderer:
    """Renders scenes with a trained network.

        renderer = Renderer.load("data/runs/quickstart/latest/checkpoints/best.ckpt")
        images = renderer.render(load_scene("data/scenes/cornell_box.json"))

    It remembers what objects were encoded to, the light of the last scene and what cameras saw first, so that another
    view costs its own and an edited scene what the edit changed. The image is the one a new renderer would give, on
    a CPU to the last bit. Threads may share it.

    Args:
        network: RaggedBatch → Rendering. The renderer's from here on: its weights must not change, and most are
            converted to `dtype`.
        info: what its checkpoint says about it.
        device: where to run.
        dtype: of matrix products.
    """

    def __init__(
        self,
        network: nn.Module,
        info: CheckpointInfo,
        device: torch.device | str = "cpu",
        dtype: torch.dtype = torch.float32,
    ):
        self.network, self.info, self.device = network.to(device).eval(), info, torch.device(device)
        self.dtype = dtype
        convert_blocks(self.network, dtype)
        self.encoder = SceneEncoder(network, self.device, dtype)
        #: What encodes object by object; None for a network whose tokens are triangles.
        self.objects = self.encoder.objects
        #: What cameras see, and what is known of scenes.
        self.gbuffers = GBufferSource(network.gbuffer_channels)
        #: Whether a thread casts the next view's rays while the network works on one: not on the same cores.
        self.casts_ahead = self.device.type != "cpu"
        #: The last stage alone.
        self.refined = Refiner(network, self.device, self.encoder.autocast)

    @classmethod
    def load(
        cls, checkpoint: Path | str, device: torch.device | str | None = None, precision: str = "auto"
    ) -> Renderer:
        """Load a checkpoint, onto a GPU if there is one.

        Args:
            checkpoint: see `rfpp.checkpoint.loading.load_network`.
            precision: see `rfpp.model.matrix_precision.matrix_dtype`.

        Raises:
            CheckpointError: it cannot be read, or is not of a network we know.
            UserError: no such precision.
        """
        device = torch.device(device or ("cuda" if torch.cuda.is_available() else "cpu"))
        dtype = matrix_dtype(precision, device)
        return cls(*load_network(checkpoint), device, dtype)

    def save(
        self, folder: Path | str, metrics: Mapping[str, Mapping[str, float | str]] | None = None, notes: str = ""
    ) -> Path:
        """Write the network as a folder that `load` reads, here or from the hub: safetensors, config and a model card.

        Weights are written as this renderer holds them: load with precision="fp32" to pass them on unrounded.

        Args:
            metrics: row → metric → number for the card, from an evaluation.
            notes: Markdown for the card, e.g. what the network cannot do.

        Raises:
            UserError: it cannot be written.
        """
        folder, parameters = Path(folder), sum(p.numel() for p in self.network.parameters())
        card = model_card(self.info, parameters, folder.name, metrics or {}, notes)
        about = replace(self.info, mlflow_run_id=None, mlflow_tracking_uri=None)  # whose store others do not have
        return write_folder(folder, {CHECKPOINT_KEY: about.to_dict()}, self.network.state_dict(), card)

    def render(
        self,
        scene: Scene | PackedScene,
        resolution: int | tuple[int, int] | None = None,
        cameras: Sequence[Camera] | None = None,
        light_samples: int = 16,
        supersampling: int = 2,
        token_resolution: int | None = None,
        transports: int | None = None,
    ) -> Float[np.ndarray, "v h w 3"]:
        """Linear radiance seen by each camera; the scene is encoded once for all of them.

        Args:
            scene: what to render.
            resolution: pixels, a number for square images or (height, width); None is the training resolution.
            cameras: None renders the scene's own.
            light_samples: shadow rays per light and pixel, rays into reflections, and up to four rays to cells, for
                networks that are given direct light, reflections or cells.
            supersampling: points along each side of a pixel at which such networks' images are shaded, which smooths
                outlines; the samples are divided among them, and each point gets one or more.
            token_resolution: at least so many pixels along the longer side are what such networks' ray tokens and image
                head see; what they say is carried to the image's pixels along surfaces. None is `TOKEN_RESOLUTION`.
            transports: how often the transport operator is applied; None is as often as it was trained for.

        Raises:
            SceneError: there is no camera.
            UserError: the resolution does not divide into the network's patches or takes more memory than there is, or
                there are no samples.
        """
        sampling = (light_samples, supersampling, token_resolution, transports)
        return np.stack(list(self.views(scene, resolution, cameras, *sampling)))

    def render_lights(
        self, scene: Scene | PackedScene, resolution: int | tuple[int, int] | None = None, **sampling: int | None
    ) -> dict[str, Float[np.ndarray, "v h w 3"]]:
        """The images of each light alone, by the name of its object; their sum is that of `render`, to rounding.

        Not in the paper. Weighted sums of them are the images with lights dimmed, switched off or coloured. They are
        not refined, where a network refines its images: their sum passed through `refined` is that of `render`.

        Args:
            resolution, sampling: see `render`.

        Raises:
            UserError: like `render`, and for a network that is not linear in lights.
        """
        packed = pack(scene)
        return {
            name: np.stack(list(self.views(packed, resolution, light=name, **sampling)))
            for name in packed.triangles.light_names
        }

    def render_bounces(
        self, scene: Scene | PackedScene, resolution: int | tuple[int, int] | None = None, **sampling: int | None
    ) -> Float[np.ndarray, "n v h w 3"]:
        """The light that arrives after one reflection, after two, …; the sum is the image of `render`, to rounding.

        Not in the paper. The first is direct light; each application of the transport operator (`transports`) adds one
        after the second. As with `render_lights`, nothing is refined.

        Args:
            resolution, sampling: see `render`.

        Raises:
            UserError: like `render`, and for a network that is not linear in lights.
        """
        plan = self.planned(pack(scene), resolution, **sampling)
        self._require_linear("bounces")
        return np.stack(list(self._views(plan, None, self.encoder.encode_each, self._decode_each)), axis=1)

    def views(
        self,
        scene: Scene | PackedScene,
        resolution: int | tuple[int, int] | None = None,
        cameras: Sequence[Camera] | None = None,
        light_samples: int = 16,
        supersampling: int = 2,
        token_resolution: int | None = None,
        transports: int | None = None,
        light: str | None = None,
        refined: bool = True,
    ) -> Iterator[Float[np.ndarray, "h w 3"]]:
        """The images of `render`, each as soon as it is finished.

        Args:
            light: only the light of this object; None: all. For a network that is linear in lights; not refined.
            refined: whether images pass through the network's refinement, if it has one.
        """
        packed = pack(scene) if cameras is None else pack(scene).seen_by(cameras)
        plan = Plan.of(
            self.network,
            packed,
            self.image_size(resolution),
            light_samples,
            supersampling,
            token_resolution,
            transports,
        )
        if light is not None:
            self._require_linear("lights")
        return self._views(plan, light, self.encoder.encode, partial(self._decode, refined=refined and light is None))

    def planned(
        self, scene: PackedScene, resolution: int | tuple[int, int] | None = None, **sampling: int | None
    ) -> Plan:
        """What an image takes. Arguments and errors: see `render`."""
        return Plan.of(self.network, scene, self.image_size(resolution), **sampling)

    def _require_linear(self, parts: str) -> None:
        if not self.network.linear_in_lights:
            raise UserError(f"{parts} apart: this network's image is no sum over {parts}: use one of linear light")

    def _views(
        self,
        plan: Plan,
        light: str | None,
        encode: Callable[[RaggedBatch, Plan, str | None], Encoded],
        decode: Callable[[Encoded, View, Plan], Float[np.ndarray, "*n height width 3"]],
    ) -> Iterator[Float[np.ndarray, "*n height width 3"]]:
        """One view at a time, which bounds the memory; see `casts_ahead`."""
        cast = self.gbuffers.of(plan.scene, *plan.size, plan.samples, plan.points, light)
        with ThreadPoolExecutor(1, "gbuffer") as beside:
            upcoming: Future | None = beside.submit(cast, 0)
            batch = self.batch(plan.scene, light)
            encoded = encode(batch, plan, light)
            for view in range(batch.num_views):
                gbuffer = upcoming.result() if upcoming else cast(view)
                more = self.casts_ahead and view + 1 < batch.num_views
                upcoming = beside.submit(cast, view + 1) if more else None
                one = slice(view, view + 1)
                image = decode(encoded, (batch.c2w[:, one], batch.fov[:, one], gbuffer), plan)
                self._require_finite(image, f"scene '{plan.scene.name}', view {view}")
                yield image

    def batch(self, scene: PackedScene, light: str | None = None) -> RaggedBatch:
        """A scene as the network reads it, without G-buffers.

        Args:
            light: see `views`.
        """
        no_gbuffer = np.zeros((len(scene.fov), 0, 0, 0), np.float32)
        known = self.gbuffers.known_of_scene(scene.triangles, self.network.reads, light)
        views = SceneViews(
            scene.name, scene.triangles, scene.c2w, scene.fov, no_gbuffer, texture=scene.texture, **known
        )
        return RaggedBatch.pack([views])

    def _require_finite(self, image: Float[np.ndarray, "*n height width 3"], what: str) -> None:
        """Raises UserError naming the cause, as far as it is known."""
        wrong = np.count_nonzero(~np.isfinite(image).all(axis=-1))
        if not wrong:
            return
        if all(torch.isfinite(weight).all() for weight in self.network.parameters()):
            why = "its lights, its sizes or its camera's distance are beyond what can be computed: check the scene"
        else:
            why = "the network's weights are not finite, its training diverged: take an earlier checkpoint"
        raise UserError(f"{what}: {wrong} of {image.size // 3} pixels are not finite: {why}")

    @torch.inference_mode()
    def _decode(
        self, encoded: EncodedScenes, view: View, plan: Plan, refined: bool = False
    ) -> Float[np.ndarray, "height width 3"]:
        c2w, fov, gbuffer = view
        camera, seen = (c2w.to(self.device), fov.to(self.device)), torch.from_numpy(gbuffer[None, None])
        with self.encoder.autocast():
            log_radiance = self.network.view(encoded, *camera, seen.to(self.device), plan.points, plan.stride, refined)
        return log_decode(log_radiance)[0, 0].permute(1, 2, 0).clamp_min(0).cpu().numpy()

    def _decode_each(
        self, encoded: list[EncodedScenes], view: View, plan: Plan
    ) -> Float[np.ndarray, "n height width 3"]:
        """Direct light, and what each of the states adds to those before it."""
        c2w, fov, gbuffer = view
        direct = (c2w, fov, direct_alone(gbuffer, self.network.gbuffer_channels))
        after = [self._decode(encoded[0], direct, plan), *(self._decode(state, view, plan) for state in encoded)]
        return np.diff(np.stack(after), axis=0, prepend=np.float32(0)).clip(0)

    def image_size(self, resolution: int | tuple[int, int] | None) -> tuple[int, int]:
        """(height, width) of a requested resolution. Raises UserError when it does not divide into patches."""
        return image_size(self.network, tuple(self.info.resolution) if resolution is None else resolution)
