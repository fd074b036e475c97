"""Ablate parts of a trained network to find those it does not use."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from rfpp.batch import RaggedBatch
from rfpp.losses.log_l1 import log_l1
from rfpp.model.lit_cells import LitCells
from rfpp.model.renderformer_pp import EncodedScenes, RenderFormerPP
from rfpp.model.layers.scene_tokens import SceneTokens
from rfpp.packed_cells import LIGHT, PackedCells

#: The scene tokens of another scene in place of its own; they keep their places, and the light they start with.
EXCHANGED_TOKENS = "exchanged_tokens"
#: And the light that they carry once it has moved, theirs or their cells': all that the decoder is told of the scene.
EXCHANGED_SCENE = "exchanged_scene"
#: The light of each scene's cells, dealt to them anew.
PERMUTED_LIGHT = "permuted_light"
#: The operator not applied at all: K = 0.
NO_TRANSPORT = "no_transport"


@dataclass(frozen=True)
class Donation:
    """What a scene gives to others in place of their own.

    Attributes:
        features: [N, D] scene tokens before light has moved.
        encoded: after it has.
    """

    features: Float[Tensor, "n width"]
    encoded: EncodedScenes


def impaired(
    network: RenderFormerPP, batch: RaggedBatch, donor: Donation, supersampling: int = 1
) -> dict[str, Float[Tensor, "b v 3 h w"]]:
    """log10(1 + radiance) with one part made useless at a time, by what was done; only what the network has.

    Args:
        network: in evaluation mode.
        donor: what other scenes give, of as many tokens as there may be (`donated`).
    """
    exposure, tokens = network.tokenize(batch)

    def decoded(scenes: EncodedScenes) -> Float[Tensor, "b v 3 h w"]:
        return network.view(scenes, batch.c2w, batch.fov, batch.gbuffer, supersampling)

    def view(tokens: SceneTokens) -> Float[Tensor, "b v 3 h w"]:
        return decoded(network.transported(exposure, tokens))

    images = {
        EXCHANGED_TOKENS: view(replace(tokens, features=_repeated(donor.features, tokens.features))),
        EXCHANGED_SCENE: decoded(_told(network.transported(exposure, tokens), donor.encoded.tokens)),
    }
    if tokens.cells is not None:
        cells = tokens.cells
        assert isinstance(cells, PackedCells)  # not lit yet
        order = _within_scenes(cells.scenes.index)
        dealt = replace(cells, **{name: getattr(cells, name)[order] for name in LIGHT})
        images[PERMUTED_LIGHT] = view(replace(tokens, cells=dealt))
    if network.iterations:
        (still, *_), _ = network.transported_each(exposure, tokens, 0)
        images[NO_TRANSPORT] = decoded(still)
    return images


def donated(network: RenderFormerPP, batch: RaggedBatch) -> Donation:
    """What the scenes of a batch give to others."""
    exposure, tokens = network.tokenize(batch)
    return Donation(tokens.features, network.transported(exposure, tokens))


class ErrorGrowth:
    """By how much log-L1 grows with each part made useless, over scenes that are given one after another.

    The first scene has no other's tokens to be given, and is left out.
    """

    def __init__(self) -> None:
        self._donor: Donation | None = None
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


def _told(scenes: EncodedScenes, by: SceneTokens) -> EncodedScenes:
    """With the tokens' features, and the light of cells, of other scenes. Where they are, and what reflects, stays."""
    tokens, cells = scenes.tokens, scenes.tokens.cells
    if isinstance(cells, LitCells):
        others = by.lit_cells
        cells = replace(
            cells,
            features=_repeated(others.features, cells.features),
            first=_repeated(others.first, cells.first),
            arriving=_repeated(others.arriving, cells.arriving),
            before=_repeated(others.before, cells.before),
        )
    return replace(scenes, tokens=replace(tokens, features=_repeated(by.features, tokens.features), cells=cells))


def _repeated(rows: Float[Tensor, "m c"], like: Float[Tensor, "n c"]) -> Float[Tensor, "n c"]:
    """As many rows as are needed, from the first on again where there are too few."""
    return rows[torch.arange(len(like), device=rows.device) % len(rows)].to(like)


def _within_scenes(scene: Tensor) -> Tensor:
    """[C] a permutation of rows that keeps each in its scene; the same every time."""
    keys = torch.rand(len(scene), generator=torch.Generator().manual_seed(0)).to(scene.device)
    shuffled = keys.argsort()
    return shuffled[scene[shuffled].argsort(stable=True)]
