"""Ablate parts of a trained network to find those it does not use."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from rfpp.batch import RaggedBatch
from rfpp.losses.log_l1 import log_l1
from rfpp.model.renderformer_pp import RenderFormerPP
from rfpp.model.tokenizer import SceneTokens
from rfpp.packed_cells import LIGHT, PackedCells

#: The scene tokens of another scene in place of its own; they keep their places, and the light they start with.
EXCHANGED_TOKENS = "exchanged_tokens"
#: The light of each scene's cells, dealt to them anew.
PERMUTED_LIGHT = "permuted_light"
#: The operator not applied at all: K = 0.
NO_TRANSPORT = "no_transport"


def impaired(
    network: RenderFormerPP, batch: RaggedBatch, donor: Float[Tensor, "n width"], supersampling: int = 1
) -> dict[str, Float[Tensor, "b v 3 h w"]]:
    """log10(1 + radiance) with one part made useless at a time, by what was done; only what the network has.

    Args:
        network: in evaluation mode.
        donor: scene tokens of other scenes, as many as there may be (`donated`).
    """
    exposure, tokens = network.tokenize(batch)

    def view(tokens: SceneTokens) -> Float[Tensor, "b v 3 h w"]:
        return network.view(network.transported(exposure, tokens), batch.c2w, batch.fov, batch.gbuffer, supersampling)

    rows = torch.arange(len(tokens.features), device=donor.device) % len(donor)
    images = {EXCHANGED_TOKENS: view(replace(tokens, features=donor[rows].to(tokens.features)))}
    if tokens.cells is not None:
        cells = tokens.cells
        assert isinstance(cells, PackedCells)  # not lit yet
        order = _within_scenes(cells.scenes.index)
        dealt = replace(cells, **{name: getattr(cells, name)[order] for name in LIGHT})
        images[PERMUTED_LIGHT] = view(replace(tokens, cells=dealt))
    if network.iterations:
        (still, *_), _ = network.transported_each(exposure, tokens, 0)
        images[NO_TRANSPORT] = network.view(still, batch.c2w, batch.fov, batch.gbuffer, supersampling)
    return images


def donated(network: RenderFormerPP, batch: RaggedBatch) -> Float[Tensor, "n width"]:
    """The scene tokens of a batch, before light has moved, to give to others."""
    return network.tokenize(batch)[1].features


class ErrorGrowth:
    """By how much log-L1 grows with each part made useless, over scenes that are given one after another.

    The first scene has no other's tokens to be given, and is left out.
    """

    def __init__(self) -> None:
        self._donor: Tensor | None = None
        self._errors: dict[str, list[Tensor]] = defaultdict(list)

    def add(self, network: RenderFormerPP, batch: RaggedBatch, as_it_is: Float[Tensor, "b v 3 h w"]) -> None:
        """One more batch.

        Args:
            as_it_is: log10(1 + radiance) that the network gives.
        """
        assert batch.image is not None
        if self._donor is not None:
            images = {"": as_it_is, **impaired(network, batch, self._donor)}
            for what, image in images.items():
                self._errors[what].append(log_l1(image, batch.image))
        self._donor = donated(network, batch)

    def shares(self) -> dict[str, float]:
        """As shares of the error as it is, by what was done; at 0 the part could as well be left out."""
        errors = {what: torch.stack(of_scenes).mean().item() for what, of_scenes in self._errors.items()}
        return {what: error / errors[""] - 1 for what, error in errors.items() if what}


def _within_scenes(scene: Tensor) -> Tensor:
    """[C] a permutation of rows that keeps each in its scene; the same every time."""
    keys = torch.rand(len(scene), generator=torch.Generator().manual_seed(0)).to(scene.device)
    shuffled = keys.argsort()
    return shuffled[scene[shuffled].argsort(stable=True)]
