"""Ablate parts of a trained network: growth of its error without its own tokens or without its operator."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from rfpp.batch import RaggedBatch
from rfpp.losses.log_l1 import log_l1
from rfpp.model.renderformer_pp import RenderFormerPP

#: Another scene's tokens before transport.
OTHER_TOKENS = "other_tokens"
#: Another scene's tokens after transport: all that the decoder reads of the scene.
OTHER_ENCODED_TOKENS = "other_encoded_tokens"
#: K = 0: the operator is not applied.
NO_OPERATOR = "no_operator"


@dataclass(frozen=True)
class TokenFeatures:
    """Token features of one batch, as replacements for those of another."""

    tokens: Float[Tensor, "n width"]
    encoded: Float[Tensor, "n width"]

    @classmethod
    def of(cls, network: RenderFormerPP, batch: RaggedBatch) -> TokenFeatures:
        """Encode a batch."""
        exposure, tokens = network.tokenize(batch)
        return cls(tokens.features, network.transported(exposure, tokens).tokens.features)


def ablated(network: RenderFormerPP, batch: RaggedBatch, other: TokenFeatures) -> dict[str, Float[Tensor, "b v 3 h w"]]:
    """Render a batch once per ablation.

    Args:
        other: Token features of other scenes. They are repeated where there are too few.

    Returns:
        log10(1 + radiance) by ablation. `NO_OPERATOR` is absent for a network without an operator.
    """
    exposure, tokens = network.tokenize(batch)
    encoded = network.transported(exposure, tokens)
    replaced = replace(tokens, features=_repeated(other.tokens, tokens.features))
    scenes = {
        OTHER_TOKENS: network.transported(exposure, replaced),
        OTHER_ENCODED_TOKENS: replace(
            encoded, tokens=replace(encoded.tokens, features=_repeated(other.encoded, encoded.tokens.features))
        ),
    }
    if network.iterations:
        (scenes[NO_OPERATOR], *_), _ = network.transported_each(exposure, tokens, 0)
    return {name: network.view(each, batch.c2w, batch.fov, batch.gbuffer) for name, each in scenes.items()}


def token_spread(features: Float[Tensor, "n width"]) -> Float[Tensor, ""]:
    """Return the share of the tokens' mean square that is not common to all of them.

    It is about 0.5 before training. At 0 all tokens are equal: none says anything of its object.
    """
    features = features.float()
    return features.var(0, unbiased=False).sum() / features.square().mean(0).sum()


class AblationErrors:
    """Errors of a network with and without each part, and the spread of its tokens, accumulated over scenes.

    Each batch is rendered with the tokens of the batch before. The first batch has none and is skipped.
    """

    def __init__(self) -> None:
        self._other: TokenFeatures | None = None
        self._errors: dict[str, list[Tensor]] = defaultdict(list)
        self._spreads: list[Tensor] = []

    def add(self, network: RenderFormerPP, batch: RaggedBatch, log_radiance: Float[Tensor, "b v 3 h w"]) -> None:
        """Add one batch.

        Args:
            log_radiance: log10(1 + radiance) of the unmodified network.
        """
        assert batch.image is not None
        if self._other is not None:
            for name, image in {"": log_radiance, **ablated(network, batch, self._other)}.items():
                self._errors[name].append(log_l1(image, batch.image))
        self._other = TokenFeatures.of(network, batch)
        self._spreads.append(token_spread(self._other.tokens))

    def growth(self) -> dict[str, float]:
        """Return the relative growth of log-L1 by ablation; 0 means that the part is not used."""
        means = {name: torch.stack(errors).mean().item() for name, errors in self._errors.items()}
        return {name: mean / means[""] - 1 for name, mean in means.items() if name}

    def spread(self) -> float:
        """Return the mean `token_spread` before transport."""
        return torch.stack(self._spreads).mean().item()


def _repeated(rows: Float[Tensor, "m c"], like: Float[Tensor, "n c"]) -> Float[Tensor, "n c"]:
    """Repeat or cut rows to the length of `like`."""
    return rows[torch.arange(len(like), device=rows.device) % len(rows)].to(like)
