"""Cast all rays of a stored scene: G-buffers, direct light, reflections and cells."""

from __future__ import annotations

from copy import copy
from functools import cached_property
from typing import SupportsFloat

import numpy as np
from jaxtyping import Float

from rfpp.radiosity.cell_finding import find_cells
from rfpp.radiosity.cells import CellMap, Cells
from rfpp.raycast.first_hit import GBuffer, camera_caster, first_hit
from rfpp.radiosity.pixel_rays import with_cells
from rfpp.raycast.known_light import with_known_light
from rfpp.raycast.light_sampler import LightSampler
from rfpp.raycast.object_light import object_light
from rfpp.scene.triangles import SceneTriangles


class SceneRays:
    """Ray casting for one scene: G-buffers of its cameras, and light at its surfaces.

    Attributes:
        triangles: the whole scene.
    """

    def __init__(self, triangles: SceneTriangles) -> None:
        self.triangles = triangles
        self._caster = camera_caster(triangles)
        self._lights = LightSampler(triangles)

    def lit_by(self, light: str) -> SceneRays:
        """The same scene, of which one light shines. Raises UserError if there is none of this name."""
        alone = copy(self)
        alone._lights = self._lights.only(light)
        alone.__dict__.pop("_cells", None)  # of all lights, if they were found before
        return alone

    def first_hit(self, c2w: Float[np.ndarray, "4 4"], fov: SupportsFloat, resolution: int) -> GBuffer:
        """The square G-buffer of one camera, without light (`rfpp.raycast.first_hit`)."""
        return first_hit(self.triangles, c2w, fov, resolution, resolution, self._caster)

    def lit(self, seen: GBuffer, c2w: Float[np.ndarray, "4 4"], fov: SupportsFloat, samples: int, seed: int) -> GBuffer:
        """The same with its direct light (`rfpp.raycast.known_light`)."""
        return with_known_light(seen, c2w, fov, self._lights, samples, seed, reflects=False)

    def object_light(self) -> Float[np.ndarray, "o 3"]:
        """Of every object (`rfpp.raycast.object_light`)."""
        return object_light(self._lights)

    @property
    def cells(self) -> Cells:
        """Of the scene (`rfpp.radiosity.cells`)."""
        return self._cells[0]

    @cached_property
    def _cells(self) -> tuple[Cells, CellMap]:
        return find_cells(self._lights)

    def gbuffers(
        self,
        c2w: Float[np.ndarray, "v 4 4"],
        fov: Float[np.ndarray, " v"],
        resolution: int,
        samples: int,
        seed: np.random.SeedSequence,
    ) -> tuple[GBuffer, ...]:
        """Of every camera, with direct light, reflection and the cells seen; each gets samples of its own."""
        seeds = seed.generate_state(len(c2w)).tolist()
        return tuple(
            self._complete(pose, angle, resolution, samples, noise)
            for pose, angle, noise in zip(c2w, fov, seeds, strict=True)
        )

    def _complete(
        self, c2w: Float[np.ndarray, "4 4"], fov: SupportsFloat, resolution: int, samples: int, seed: int
    ) -> GBuffer:
        lit = with_known_light(self.first_hit(c2w, fov, resolution), c2w, fov, self._lights, samples, seed)
        return with_cells(lit, c2w, fov, self._lights, self._cells[1], seed=seed)
