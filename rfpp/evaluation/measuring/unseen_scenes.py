"""Networks on stored scenes that they have not seen, as the renderer renders them, beside unlearned radiosity."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import torch
from jaxtyping import Float

from rfpp.batch import RaggedBatch, SceneViews
from rfpp.errors import UserError
from rfpp.evaluation.measuring.confidence import Bootstrap, Estimate
from rfpp.evaluation.measuring.evaluate import fitted_baselines, known_views
from rfpp.imaging.radiance import log_decode
from rfpp.inference.gbuffers import GBufferSource
from rfpp.inference.renderer import Renderer
from rfpp.metrics.flip import flip
from rfpp.metrics.image import ImageMetrics
from rfpp.metrics.lpips import LPIPS
from rfpp.model.radiosity import UnlearnedRadiosity
from rfpp.scene.packed import PackedScene
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.sample import SceneSample

Row = dict[str, str | int | float]
Images = Float[np.ndarray, "v h w 3"]
#: What images are rendered with; the renderer's defaults.
_LIGHT_SAMPLES, _POINTS = 16, 2
_METRICS = ("log_l1", "lpips", "flip", "ssim")


@dataclass(frozen=True)
class StoredScenes:
    """A split of a data set.

    Attributes:
        title: what the table calls it.
        root: folder of the data set.
        split: of it.
        same_rooms_as: title of scenes measured before, whose rooms, one by one, hold other objects.
    """

    title: str
    root: str
    split: str
    same_rooms_as: str | None = None


class Method(Protocol):
    """What renders all views of a scene at (height, width)."""

    def __call__(self, scene: PackedScene, size: tuple[int, int]) -> Images: ...


def measure(
    checkpoints: Sequence[str],
    sets: Sequence[StoredScenes],
    fitted_on: StoredScenes | None,
    baseline_scenes: int,
    bootstrap: Bootstrap,
    progress: Callable[[int, int], None],
    lpips_trunk_path: Path | str | None = None,
) -> Iterator[Row]:
    """A row per set and method: means over scenes of log-L1, LPIPS, ꟻLIP and SSIM, and by how much of radiosity's mean
    they differ from radiosity's; each with its 95% interval over scenes. Of `same_rooms_as`, also by how much of the
    errors there they differ from these, room by room. Trivial baselines predict from the stored G-buffers, of one point
    a pixel.

    Args:
        checkpoints: see `rfpp.checkpoint.loading.load_network`.
        sets: of scenes with references.
        fitted_on: what the trivial baselines are fitted on; None leaves them out.
        baseline_scenes: of it, at most.
        bootstrap: of the intervals.
        progress: called with (scenes done, scenes in all).
        lpips_trunk_path: see `rfpp.metrics.lpips_weights.trunk_weights`.

    Raises:
        CheckpointError, ShardError: what cannot be read.
        UserError: `same_rooms_as` names no scenes before, or another number of them.
    """
    metrics = ImageMetrics(LPIPS.pretrained(lpips_trunk_path))
    methods: dict[str, Method] = {UnlearnedRadiosity.name: ByRadiosity()}
    methods |= {name: ByNetwork(Renderer.load(name)) for name in checkpoints}
    splits = [ShardSplit(of.root, of.split) for of in sets]
    baselines = fitted_on and fitted_baselines(ShardSplit(fitted_on.root, fitted_on.split), baseline_scenes)
    trivial = {baseline.name: baseline for baseline in baselines or ()}
    _require_rooms(sets, splits)
    total, done = sum(map(len, splits)), 0
    by_set: dict[str, dict[str, np.ndarray]] = {}
    for of, split in zip(sets, splits, strict=True):
        errors = by_set[of.title] = {name: np.zeros((len(split), len(_METRICS))) for name in (*methods, *trivial)}
        for index in range(len(split)):
            sample = split[index]
            scene, references = _scene(sample), sample.images.astype(np.float32)
            for name, method in methods.items():
                errors[name][index] = _errors(method(scene, references.shape[1:3]), references, metrics)
            known = known_views(sample, torch.device("cpu"))[0] if trivial else {}
            for name, baseline in trivial.items():
                images = baseline.predict(known).permute(0, 2, 3, 1).numpy()
                errors[name][index] = _errors(images, references, metrics)
            done += 1
            progress(done, total)
        rival = errors[UnlearnedRadiosity.name]
        elsewhere = by_set[of.same_rooms_as] if of.same_rooms_as else {}
        for name, of_scenes in errors.items():
            yield {
                "data": of.title,
                "manifest": split.manifest.hash[:12],
                "scenes": len(split),
                "method": name,
                **_columns("", bootstrap(of_scenes)),
                **_columns("_change", bootstrap(_relative(of_scenes, rival))),
                **(_columns("_beside", bootstrap(_relative(of_scenes, elsewhere[name]))) if elsewhere else {}),
            }


def _require_rooms(sets: Sequence[StoredScenes], splits: Sequence[ShardSplit]) -> None:
    """Raises UserError: see `measure`."""
    scenes: dict[str, int] = {}
    for of, split in zip(sets, splits, strict=True):
        if of.same_rooms_as is not None and scenes.get(of.same_rooms_as) != len(split):
            raise UserError(
                f"benchmark.sets: '{of.title}' has {len(split)} scenes, '{of.same_rooms_as}' "
                f"{scenes.get(of.same_rooms_as, 'is not before it')}: generate as many of both, in this order"
            )
        scenes[of.title] = len(split)


def _relative(errors: Float[np.ndarray, "scenes m"], rival: Float[np.ndarray, "scenes m"]) -> np.ndarray:
    """[scenes, m] differences, as shares of the rival's means."""
    return (errors - rival) / rival.mean(axis=0)


def _scene(sample: SceneSample) -> PackedScene:
    return PackedScene(sample.key, sample.triangles, sample.c2w, sample.fov)


def _columns(what: str, estimates: Sequence[Estimate]) -> Row:
    return {
        f"{metric}{what}{end}": value
        for metric, estimate in zip(_METRICS, estimates, strict=True)
        for end, value in (("", estimate.mean), ("_low", estimate.low), ("_high", estimate.high))
    }


def _errors(images: Images, references: Images, metrics: ImageMetrics) -> Float[np.ndarray, " metrics"]:
    """Means over views."""
    x, y = (torch.from_numpy(np.ascontiguousarray(of.transpose(0, 3, 1, 2))) for of in (images, references))
    means = {name: float(values.mean()) for name, values in metrics(x, y).items()}
    means["flip"] = float(np.mean([flip(*pair).mean() for pair in zip(images, references, strict=True)]))
    return np.array([means[name] for name in _METRICS])


class ByNetwork:
    """A trained network."""

    def __init__(self, renderer: Renderer):
        self.renderer = renderer

    def __call__(self, scene: PackedScene, size: tuple[int, int]) -> Images:
        return self.renderer.render(scene, size, light_samples=_LIGHT_SAMPLES, supersampling=_POINTS)


class ByRadiosity:
    """`UnlearnedRadiosity`, of the same samples."""

    def __init__(self) -> None:
        self.radiosity = UnlearnedRadiosity().eval()
        self.source = GBufferSource(self.radiosity.gbuffer_channels)

    @torch.inference_mode()
    def __call__(self, scene: PackedScene, size: tuple[int, int]) -> Images:
        cast = self.source.of(scene, *size, _LIGHT_SAMPLES, _POINTS)
        known = self.source.known_of_scene(scene.triangles, ["cells"])
        images = []
        for view in range(len(scene.fov)):
            one = scene.views([view])
            seen = SceneViews(one.name, one.triangles, one.c2w, one.fov, cast(view)[None], **known)
            log_radiance = self.radiosity(RaggedBatch.pack([seen]), _POINTS).log_radiance
            images.append(log_decode(log_radiance)[0, 0].permute(1, 2, 0).numpy())
        return np.stack(images)
