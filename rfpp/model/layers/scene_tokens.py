"""Scene tokens: the features that transport and decoder work on, with the place each one stands for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from rfpp.segments import Segments


@dataclass(frozen=True)
class SceneTokens:
    """Tokens of B scenes, packed.

    Attributes:
        features: [N, D].
        points: [N, 9] three world-space points that place each token.
        log_emission: [N, 3] log10(1 + emitted radiance), the area-weighted mean over the token's triangles.
        segments: B segments of the N tokens.
    """

    features: Float[Tensor, "n width"]
    points: Float[Tensor, "n 9"]
    log_emission: Float[Tensor, "n 3"]
    segments: Segments

    @classmethod
    def joined(cls, parts: Sequence[SceneTokens], objects: Sequence[int]) -> SceneTokens:
        """Concatenate the tokens of single objects into scenes with these numbers of objects."""
        names = ("features", "points", "log_emission")
        features, points, emission = (torch.cat([getattr(part, name) for part in parts]) for name in names)
        per_object = len(features) // sum(objects)
        segments = Segments.from_lengths([per_object * count for count in objects], features.device)
        return cls(features, points, emission, segments)

    def split(self, objects: int) -> list[SceneTokens]:
        """Split into the tokens of each object, copied so that each can be freed alone."""
        parts = zip(*(x.chunk(objects) for x in (self.features, self.points, self.log_emission)), strict=True)
        segments = Segments.from_lengths([len(self.features) // objects], self.features.device)
        return [SceneTokens(f.clone(), p.clone(), e.clone(), segments) for f, p, e in parts]
