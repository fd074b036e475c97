"""Errors of the light that a network adds to known light, against clean references."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from rfpp.evaluation.measuring.clean_views import POINTS, CleanScene, clean_scene
from rfpp.evaluation.measuring.confidence import INTERVAL, Estimate
from rfpp.imaging.radiance import log_decode, log_encode
from rfpp.losses.error_growth import Donation, donated, impaired
from rfpp.losses.log_l1 import log_l1
from rfpp.model.radiosity import UnlearnedRadiosity
from rfpp.shards.dataset import ShardSplit

#: Errors are of means over squares of so many pixels: further light is smooth, and edges and noise are other matters.
SQUARE = 8
AS_IT_IS = "as_it_is"


@dataclass
class LightErrors:
    """Errors of one predictor on S scenes, unchanged and with parts disabled (`rfpp.losses.error_growth`).

    Attributes:
        wrong: by what was done, of every scene Σ |m(x) − m(y)|, m the means over squares of what was added to known
            light, and of what is to be added.
        log_l1: likewise, mean |log10(1 + x) − log10(1 + y)|.
        there: of every scene, Σ |m(y)|.
        added, to_add: of every scene, Σ m(x) and Σ m(y), as it is.
    """

    wrong: dict[str, list[float]] = field(default_factory=dict)
    log_l1: dict[str, list[float]] = field(default_factory=dict)
    there: list[float] = field(default_factory=list)
    added: list[float] = field(default_factory=list)
    to_add: list[float] = field(default_factory=list)

    def add(self, what: str, added: Float[Tensor, "v 3 h w"], to_add: Float[Tensor, "v 3 h w"], log_l1: float) -> None:
        """One more scene.

        Args:
            added, to_add: see `CleanScene`.
        """
        of_image, of_reference = (F.avg_pool2d(x, SQUARE) for x in (added, to_add))
        self.wrong.setdefault(what, []).append((of_image - of_reference).abs().sum().item())
        self.log_l1.setdefault(what, []).append(log_l1)
        if what == AS_IT_IS:
            self.there.append(of_reference.abs().sum().item())
            self.added.append(of_image.sum().item())
            self.to_add.append(of_reference.sum().item())

    def further(self, resamples: int = 10_000, seed: int = 0) -> Estimate:
        """Relative L1 of further light, Σ |m(x) − m(y)| / Σ |m(y)| over all scenes; 95% by bootstrap over scenes."""
        wrong, there = np.array(self.wrong[AS_IT_IS]), np.array(self.there)
        draws = np.random.default_rng(seed).integers(len(there), size=(resamples, len(there)))
        low, high = np.percentile(wrong[draws].sum(1) / there[draws].sum(1), INTERVAL)
        return Estimate(float(wrong.sum() / there.sum()), float(low), float(high), len(there))

    def median(self) -> float:
        """Relative L1 of further light in the median scene."""
        return float(np.median(np.array(self.wrong[AS_IT_IS]) / np.array(self.there)))

    def energy(self) -> float:
        """Ratio of predicted to reference further light, over all scenes."""
        return sum(self.added) / sum(self.to_add)

    def growth(self) -> dict[str, float]:
        """Relative growth of log-L1 with each part disabled."""
        # the first scene has no other's tokens to be given
        rest = {what: np.mean(errors[-(len(self.there) - 1) :]) for what, errors in self.log_l1.items()}
        return {what: float(error / rest[AS_IT_IS]) - 1 for what, error in rest.items() if what != AS_IT_IS}


@torch.no_grad()
def measure(
    predictors: dict[str, nn.Module | None],
    split: ShardSplit,
    folder: Path,
    autocast: Callable[[], torch.autocast],
    on_scene: Callable[[], None] = lambda: None,
) -> dict[str, LightErrors]:
    """Measure every predictor on every scene of a split, with noise-free known light.

    Args:
        predictors: networks in evaluation mode on the CPU, `UnlearnedRadiosity`, or None for known light alone.
        folder: where rays are kept once they are cast.
        autocast: the precision networks compute in.
        on_scene: called after each scene, for a progress bar.
    """
    errors = {name: LightErrors() for name in predictors}
    donors: dict[str, Donation] = {}
    for index in range(len(split)):
        scene = clean_scene(split, index, folder)
        for name, network in predictors.items():
            for what, image in _images(network, scene, donors, name, autocast):
                error = log_l1(log_encode(image.clamp_min(0)), scene.reference).item()
                errors[name].add(what, scene.added_by(image), scene.to_add, error)
        on_scene()
    return errors


def _images(
    network: nn.Module | None,
    scene: CleanScene,
    donors: dict[str, Donation],
    name: str,
    autocast: Callable[[], torch.autocast],
) -> Sequence[tuple[str, Float[Tensor, "v 3 h w"]]]:
    """Linear radiance by disabled part; what is given to the next scene is stored in `donors`."""
    if network is None:
        return [(AS_IT_IS, scene.known)]
    batch = scene.batch(tuple(network.gbuffer_channels))
    with autocast():
        images = {AS_IT_IS: network(batch, POINTS).log_radiance}
        if not isinstance(network, UnlearnedRadiosity):
            if name in donors:
                images |= impaired(network, batch, donors[name], POINTS)
            donors[name] = donated(network, batch)
    return [(what, log_decode(image[0].float())) for what, image in images.items()]
