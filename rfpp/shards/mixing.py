"""Stored scenes under other settings of their lights: exact, without a ray or a path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from rfpp.errors import ShardError
from rfpp.raycast.first_hit import BOUNCED_LIGHT, DirectLight, GBuffer
from rfpp.scene.triangles import EMISSION
from rfpp.shards.sample import SceneSample


def mixed(sample: SceneSample, factors: Float[np.ndarray, "l 3"]) -> SceneSample:
    """The scene whose lights emit so many times what they did, with the references and the known light of that.

    Light is linear in what the lights emit, channel by channel, so all of it is a weighted sum of the sample's layers.
    The light of triangles that emit and of cells on them is scaled. A factor of 0 would make them surfaces.

    Args:
        sample: with the light of each light (`SceneSample.lights`).
        factors: of each light, red, green and blue, above 0.

    Raises:
        ShardError: naming the sample, which was stored without.
    """
    layers = sample.lights
    if layers is None:
        raise ShardError(
            f"{sample.key}: its lights are not stored apart: generate the data with data.by_light=true, or set "
            "datamodule.light_augmentation=null"
        )
    factors = factors.astype(np.float32)
    of_object = np.ones((sample.triangles.num_objects, 3), np.float32)
    of_object[layers.objects] = factors
    material = sample.triangles.material.copy()
    material[:, EMISSION] *= of_object[sample.triangles.object_index]

    def summed(of_lights: Float[np.ndarray, "l *rest 3"]) -> np.ndarray:
        return np.einsum("l...c,lc->...c", of_lights, factors)

    known = {name: summed(of_lights) for name, of_lights in layers.known.items()}
    return replace(
        sample,
        triangles=replace(sample.triangles, material=material),
        images=summed(layers.images),
        gbuffers=tuple(
            _relit(gbuffer, {name: of[view] for name, of in known.items()})
            for view, gbuffer in enumerate(sample.gbuffers)
        ),
        object_light=summed(layers.object_light),
        cells=replace(
            sample.cells,
            emitted=sample.cells.emitted * of_object[sample.cells.octant // 8],
            arriving=summed(layers.arriving),
            highlights=summed(layers.highlights),
        ),
    )


def _relit(gbuffer: GBuffer, known: dict[str, Float[np.ndarray, "h w 3"]]) -> GBuffer:
    """With other light, where it has any."""
    light, reflection, cells = gbuffer.light, gbuffer.reflection, gbuffer.cells
    return replace(
        gbuffer,
        light=light and DirectLight(known["direct_diffuse"], known["direct_glossy"]),
        reflection=reflection and replace(reflection, light=known["reflected_light"]),
        cells=cells and replace(cells, bounced=known[BOUNCED_LIGHT]),
    )
