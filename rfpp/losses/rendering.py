"""The training objective: L1 in log radiance, LPIPS, transport consistency, each with its weight (paper, Sec. 3.4)."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor, nn

from rfpp.errors import UserError
from rfpp.losses.log_l1 import log_l1
from rfpp.losses.perceptual import PerceptualLoss
from rfpp.losses.token_light import TokenLight
from rfpp.losses.transport_consistency import TransportConsistency
from rfpp.ranges import NonNegativeFloat, Positive
from rfpp.segments import Segments


class RenderingLoss(nn.Module):
    """λ₁ · L1 + λ_lpips · LPIPS + λ_cons · Σ_k consistency_k, and with a weight λ_light · light of tokens.

    Args:
        l1_weight, lpips_weight, consistency_weight: the paper's 1, 0.05 and 0.1; a weight of 0 leaves LPIPS out.
        lpips_images_per_step: see PerceptualLoss.
        consistency_stop_gradient: see TransportConsistency.
        token_light: See `TokenLight`; None leaves it out.
        token_light_weight: Its weight.
    """

    def __init__(
        self,
        l1_weight: NonNegativeFloat,
        lpips_weight: NonNegativeFloat,
        consistency_weight: NonNegativeFloat,
        lpips_images_per_step: Positive | None,
        consistency_stop_gradient: bool,
        token_light: TokenLight | None = None,
        token_light_weight: NonNegativeFloat = 0.0,
    ):
        super().__init__()
        self.l1_weight, self.lpips_weight, self.consistency_weight = l1_weight, lpips_weight, consistency_weight
        self.perceptual = PerceptualLoss(lpips_images_per_step) if lpips_weight > 0 else None
        self.consistency = TransportConsistency(consistency_stop_gradient)
        self.token_light, self.token_light_weight = token_light, token_light_weight

    def forward(
        self,
        log_radiance: Float[Tensor, "b v 3 h w"],
        transport_states: tuple[Tensor, ...],
        target: Float[Tensor, "b v 3 h w"],
        scenes: Segments | None = None,
        token_light: Float[Tensor, "tokens k 3"] | None = None,
    ) -> dict[str, Tensor]:
        """Return every unweighted term by name; `loss` is the weighted sum.

        Names: loss, l1, lpips (where weighted), consistency and consistency_1 … consistency_K (where there are
        transport states), token_light. `target` is linear radiance; `scenes`: see TransportConsistency.

        Raises:
            UserError: If the light of tokens is to be supervised and the data has none.
        """
        terms = {"l1": log_l1(log_radiance, target)}
        loss = self.l1_weight * terms["l1"]
        if self.perceptual is not None:
            terms["lpips"] = self.perceptual(log_radiance, target)
            loss = loss + self.lpips_weight * terms["lpips"]
        if transport_states:
            residuals = self.consistency(transport_states, scenes, len(log_radiance))
            terms["consistency"] = residuals.sum()
            terms |= {f"consistency_{k}": r for k, r in enumerate(residuals, start=1)}
            loss = loss + self.consistency_weight * terms["consistency"]
        if self.token_light is not None:
            if token_light is None:
                raise UserError(
                    "loss.token_light: this data has no light of tokens: generate it with reference=radiosity"
                )
            terms["token_light"] = self.token_light(transport_states, token_light)
            loss = loss + self.token_light_weight * terms["token_light"]
        return {"loss": loss, **terms}
