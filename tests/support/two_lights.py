"""Scenes of two coloured lights, and a renderer that is linear in them and invents the rest."""

from dataclasses import dataclass

import numpy as np
from small_data import LIGHT, BoxFamily

from rfpp.scene.mesh import Mesh
from rfpp.scene.spec import Material, Scene, SceneObject, Transform
from rfpp.scene.triangles import EMISSION, SceneTriangles

#: What they emit.
POWERS = np.array([[3000.0, 2000.0, 1000.0], [1000.0, 1500.0, 2500.0]])
_ELSEWHERE = Mesh(LIGHT.vertices * [1, 1, 0.9] + [0.8, -0.3, 0], LIGHT.faces)


@dataclass(frozen=True)
class TwoLights(BoxFamily):
    """Boxes whose lights emit `factors` times POWERS."""

    factors: tuple[tuple[float, float, float], ...] = ((1.0, 1.0, 1.0),) * 2

    def sample(self, scene_rng, camera_rng, *, held_out) -> Scene:
        scene = super().sample(scene_rng, camera_rng, held_out=held_out)
        lamps = (
            SceneObject(
                name=f"lamp {number}",
                mesh=mesh,
                material=Material(diffuse=(1.0,) * 3, specular=(0.0,) * 3, roughness=1.0, emissive=tuple(power)),
                transform=Transform(normalize=False),
            )
            for number, (mesh, power) in enumerate(zip((LIGHT, _ELSEWHERE), POWERS * self.factors, strict=True))
        )
        return scene.model_copy(update={"objects": (*scene.objects[:-1], *lamps)})


def invented_lights(triangles: SceneTriangles, c2w, fov, height, width, settings) -> np.ndarray:
    """As `cycles.render_lights`: noise of each light's own, as bright as it."""
    lights = np.flatnonzero(np.bincount(triangles.object_index[triangles.is_emissive]))
    emitted = triangles.material[triangles.object_offsets[lights], EMISSION]
    shape = (len(lights), len(c2w), height, width, 3)
    return np.random.default_rng(settings.seed).exponential(2e-4, shape) * emitted[:, None, None, None]
