"""Compare optimizers at equal steps and equal time."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import torch
from hydra.utils import instantiate

from rfpp.batch import RaggedBatch
from rfpp.benchmark.cost.rows import Row, read_rows
from rfpp.benchmark.cost.tasks import Setting
from rfpp.checkpoint.network_building import build
from rfpp.imaging.radiance import log_decode
from rfpp.metrics.image import log_l1
from rfpp.model.renderformer_pp import RenderFormerPP
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.order import ShuffledOrder, leading
from rfpp.shards.sample import SceneSample, ViewChoice
from rfpp.shards.views import AllViews
from rfpp.training.dealing import InOrder
from rfpp.training.module import decay_groups
from rfpp.training.views import GlobalBatches, TrainingViews

_NEEDED = {"optimizer", "seed", "step", "seconds", "log_l1", "steps"}


def measure(
    compose: Callable[[list[str]], Mapping[str, Any]],
    runs: Mapping[str, Sequence[str]],
    seeds: Sequence[int],
    every: int,
    split: str,
    setting: Setting,
    minutes: float | int,
    finished: str | None,
    progress: Callable[[int, int], None],
) -> Iterator[Row]:
    """Trains each network anew: rows of its mean log-L1 on unseen scenes every so many steps.

    `seconds` are of training with all that a step takes, views drawn from scenes in memory in the same process: nothing
    is tracked or saved, and LPIPS is left out.

    Args:
        compose: overrides → training's configuration.
        runs: name → overrides that make its optimizer.
        seeds: of weights, order, views; each run has all.
        every: steps between two evaluations.
        split: of the scenes that are evaluated.
        setting: where and in which precision; its seed is not used.
        minutes: after so many no further training is begun; the same command then goes on.
        finished: rows of an earlier part, if the file exists: they come first, and these runs are not made again.
        progress: called with (evaluations done, in all).
    """
    begin = time.monotonic()
    known = read_rows(Path(finished), _NEEDED, "optimizers") if finished and Path(finished).exists() else []
    ended = {(row["optimizer"], int(row["seed"])) for row in known if row["step"] == row["steps"]}
    yield from (row for row in known if (row["optimizer"], int(row["seed"])) in ended)
    missing = [(name, seed) for seed in seeds for name in runs if (name, seed) not in ended]
    setting.apply()
    for number, (name, seed) in enumerate(missing):
        if time.monotonic() - begin > 60 * minutes:
            return
        cfg = compose([*runs[name], f"seed={seed}", "loss.lpips_weight=0.0"])
        evaluations = -(-cfg["steps"] // every)
        rows = _train(cfg, seed, every, split, setting)
        for done, row in enumerate(rows, start=1):
            progress(number * evaluations + done, len(missing) * evaluations)
            yield {"optimizer": name, "lr": cfg["optimizer"]["lr"], "seed": seed, **row}


class RememberedSplit(ShardSplit):
    """Stored scenes that are decoded once, for networks that are faster than decoding; without their lights apart."""

    @cached_property
    def _samples(self) -> dict[int, SceneSample]:
        return {}

    def read(self, index: int, choose: ViewChoice, channels: Collection[str], by_light: bool = False) -> SceneSample:
        if index not in self._samples:
            self._samples[index] = super().read(index, None, channels, by_light=False)
        whole = self._samples[index]
        views = list(choose(len(whole.fov)))
        of_views = {name: getattr(whole, name)[views] for name in ("c2w", "fov", "images")}
        return replace(whole, **of_views, gbuffers=tuple(whole.gbuffers[view] for view in views))


def _train(cfg: Mapping[str, Any], seed: int, every: int, split: str, setting: Setting) -> Iterator[Row]:
    torch.manual_seed(seed)
    network = build(cfg["model"], "network").to(setting.where)
    optimizer = instantiate(cfg["optimizer"])(decay_groups(network))
    schedule, loss = instantiate(cfg["schedule"])(optimizer), instantiate(cfg["loss"]).to(setting.where)
    batches = _Batches(cfg["datamodule"], network, cfg["steps"], seed)
    stored = AllViews(ShardSplit(cfg["datamodule"]["root"], split), network.gbuffer_channels)
    unseen = [RaggedBatch.pack([stored[index]]) for index in range(len(stored))]
    seconds, begin = 0.0, setting.now()
    for step, batch in enumerate(batches, start=1):
        network.train()
        moved = batch.to(setting.where)
        with setting.autocast():
            made = network(moved)
            terms = loss(made.log_radiance, made.transport_states, moved.image, made.state_segments)
        optimizer.zero_grad()
        terms["loss"].backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), cfg["trainer"]["gradient_clip_val"])
        optimizer.step()
        schedule.step()
        if step % every == 0 or step == cfg["steps"]:
            seconds += setting.now() - begin
            error = _error(network, unseen, setting)
            yield {
                "step": step, "seconds": seconds, "log_l1": error, "steps": cfg["steps"], "scenes": len(unseen),
                "training_scenes": batches.scenes, "precision": setting.precision, "torch": torch.__version__,
                "device": setting.where,
            }  # fmt: skip
            begin = setting.now()


class _Batches:
    """Batches of training draws, one after the other."""

    def __init__(self, data: Mapping[str, Any], network: RenderFormerPP, steps: int, seed: int) -> None:
        split = RememberedSplit(data["root"], "train", require_all=not data["skip_corrupt"])
        sizes = leading(split.sizes, data["training_scenes"] or len(split))
        self.scenes = sum(sizes)
        for index in range(self.scenes):  # now: decoding is no training
            split.read(index, range, network.gbuffer_channels)
        self._views = TrainingViews(
            split, network.gbuffer_channels,
            data["views_per_scene"], *(instantiate(data[f"{name}_augmentation"]) for name in ("rigid", "colour")), seed,
        )  # fmt: skip
        order = ShuffledOrder(sizes, seed, data["shuffle_shards"])
        self._draws = GlobalBatches(order, InOrder(), lambda _: 0, data["scenes_per_step"], batches=steps)

    def __iter__(self) -> Iterator[RaggedBatch]:
        return (RaggedBatch.pack([self._views[draw] for draw in draws]) for draws in self._draws)


@torch.inference_mode()
def _error(network: RenderFormerPP, unseen: Sequence[RaggedBatch], setting: Setting) -> float:
    network.eval()
    errors = []
    for batch in unseen:
        with setting.autocast():
            image = network(batch.to(setting.where)).log_radiance
        errors.append(log_l1(log_decode(image[0].float()), batch.image[0].to(setting.where)).mean())
    return float(torch.stack(errors).mean())
