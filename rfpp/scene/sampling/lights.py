"""Random lights: small emissive triangles outside the scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rfpp.scene.mesh import Mesh
from rfpp.scene.sampling.interval import HasIntervals, Interval, uniform, uniform_integer
from rfpp.scene.sampling.open_region import OpenRegion
from rfpp.scene.spec import Material, SceneObject, Transform

#: RenderFormer's light, an equilateral triangle with edges of 0.087.
TRIANGLE = ((-0.025, 0.025, 0.025), (0.025, -0.025, 0.025), (0.025, 0.025, -0.025))


@dataclass(frozen=True)
class LightSampler(HasIntervals):
    """White one-triangle objects on a shell above the scene, in front of the background.

    Attributes:
        strength: radiance of a light times the number of lights, so that their sum stays in the interval.
        scale: scale of the triangle, per axis.
        rotation: degrees, per axis.
        distance: distance from a target at the scene's center.
        target_jitter: displacement of that target per axis.
        elevation: degrees above the horizon, seen from the target.
        clearance: minimum distance of a light's origin to the plane of every panel.
        spacing: minimum distance between two lights.
        one_sided: whether lights shine only towards the scene's center.
    """

    count: Interval
    strength: Interval
    scale: Interval
    rotation: Interval
    distance: Interval
    target_jitter: Interval
    elevation: Interval
    clearance: float
    spacing: float
    one_sided: bool = False

    def sample(self, rng: np.random.Generator, open_region: OpenRegion) -> list[SceneObject]:
        """Draw the lights of a scene, named light_0, light_1, …."""
        count = uniform_integer(rng, self.count)
        positions = np.empty((0, 3))
        for _ in range(count):
            position = open_region.draw_position(
                rng,
                target=uniform(rng, self.target_jitter, 3),
                distance=uniform(rng, self.distance),
                elevation=self.elevation,
                clearance=self.clearance,
                others=positions,
                spacing=self.spacing,
            )
            positions = np.concatenate([positions, position[None]])
        return [self._light(rng, f"light_{i}", position, count) for i, position in enumerate(positions)]

    def _light(self, rng: np.random.Generator, name: str, position: np.ndarray, count: int) -> SceneObject:
        transform = Transform(
            translation=tuple(position.tolist()),
            rotation=tuple(uniform(rng, self.rotation, 3).tolist()),
            scale=tuple(uniform(rng, self.scale, 3).tolist()),
            normalize=False,
        )
        # emitters have a white diffuse lobe, as in RenderFormer's scenes
        material = Material(
            diffuse=(1.0,) * 3,
            specular=(0.0,) * 3,
            roughness=1.0,
            emissive=(uniform(rng, self.strength) / count,) * 3,
            one_sided=self.one_sided,
        )
        light = SceneObject(name=name, mesh=triangle_mesh(), material=material, transform=transform)
        a, b, c = light.world_mesh.corners[0]
        if self.one_sided and np.cross(b - a, c - a) @ position > 0:  # it faces away from the scene
            light = light.model_copy(update={"mesh": triangle_mesh(flipped=True)})
        return light


def triangle_mesh(flipped: bool = False) -> Mesh:
    """Return the mesh of every light, optionally with its back in front."""
    return Mesh(np.array(TRIANGLE), np.array([[0, 2, 1] if flipped else [0, 1, 2]]))
