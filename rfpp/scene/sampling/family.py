"""Random scene families: backgrounds, objects, materials, lights and cameras."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from rfpp.errors import SceneError
from rfpp.scene.mesh import Mesh, joined
from rfpp.scene.sampling.backgrounds import Background, BackgroundSampler
from rfpp.scene.sampling.cameras import CameraSampler
from rfpp.scene.sampling.interval import HasIntervals, Interval, uniform_integer
from rfpp.scene.sampling.lights import LightSampler
from rfpp.scene.sampling.materials import MaterialSampler
from rfpp.scene.sampling.objects.object_source import ObjectSource
from rfpp.scene.sampling.placement import Placement
from rfpp.scene.spec import Camera, Scene, SceneObject


@dataclass(frozen=True)
class TriangleBudget(HasIntervals):
    """Numbers of objects and triangles of a scene."""

    scene: Interval
    objects: Interval
    per_object: Interval

    def sample(self, rng: np.random.Generator, taken: int) -> Int[np.ndarray, " objects"]:
        """Draw even triangle counts of the objects of a scene, given `taken` triangles of background and lights.

        The total is uniform over the feasible range, the number of objects uniform over the range feasible for the
        total; objects divide the rest unevenly.

        Raises:
            SceneError: If the intervals contradict each other.
        """
        (low, high), (fewest, most), (smallest, largest) = self.scene, self.objects, self.per_object
        smallest, largest = smallest + smallest % 2, largest - largest % 2
        low, high = max(low, taken + fewest * smallest), min(high, taken + most * largest)
        if low > high:
            raise SceneError(
                f"TriangleBudget: {fewest}…{most} objects of {smallest}…{largest} triangles and {taken} of the "
                f"background and lights cannot make {self.scene[0]}…{self.scene[1]}: widen one of the intervals"
            )
        available = uniform_integer(rng, (low, high)) - taken
        count = uniform_integer(rng, (max(fewest, -(-available // largest)), min(most, available // smallest)))
        return shared_out(rng, available, count, smallest, largest)


def shared_out(
    rng: np.random.Generator, total: int, count: int, smallest: int, largest: int
) -> Int[np.ndarray, " count"]:
    """Draw `count` even numbers in [smallest, largest] (both even) with sum `total`, or one less if it is odd.

    They are smallest + (largest - smallest) · uᵞ with independent uniform u and the γ that gives the sum: uniform for
    the middle total, concentrated at one end otherwise.
    """
    u = rng.uniform(1e-6, 1 - 1e-6, count)
    low, high = -20.0, 20.0  # of log γ, far beyond float64's resolution
    for _ in range(60):
        middle = (low + high) / 2
        numbers = smallest + (largest - smallest) * u ** np.exp(middle)
        low, high = (middle, high) if numbers.sum() > total else (low, middle)
    # rounding the running sum keeps the total and changes each number by at most two
    return np.diff(np.round(np.cumsum(numbers)).astype(np.int64) // 2 * 2, prepend=0)


@dataclass(frozen=True)
class SceneFamily:
    """A distribution over scenes.

    Geometry, materials and lights come from one rng and cameras from another, so that a scene can be rendered from new
    viewpoints. Every component has its own stream: changing one does not change the draws of the others.
    """

    name: str
    objects: ObjectSource
    budget: TriangleBudget
    placement: Placement
    materials: MaterialSampler
    background_materials: MaterialSampler
    backgrounds: BackgroundSampler
    lights: LightSampler
    cameras: CameraSampler

    def sample(self, scene_rng: np.random.Generator, camera_rng: np.random.Generator, *, held_out: bool) -> Scene:
        """Draw a scene with panels background_0, …, objects object_0, …, and lights light_0, ….

        The parts of an object are separate objects of the scene, object_0_0, object_0_1, … Equal generators give equal
        scenes.

        Args:
            held_out: Use objects that are held out for test scenes, instead of all others.

        Raises:
            SceneError: If the family's numbers contradict each other.
        """
        streams = scene_rng.spawn(7)
        background = self.backgrounds.sample(streams[0])
        lights = self.lights.sample(streams[1], background.open_region)
        targets = self.budget.sample(streams[2], taken=sum(map(len, background.meshes)) + len(lights))
        drawn = [self.objects.sample(streams[3], int(target), held_out) for target in targets]
        transforms = self.placement.sample(streams[4], [joined(parts) for parts in drawn], background.open_region)
        objects = [
            SceneObject(name=name, mesh=mesh, material=self.materials.sample(streams[5]), transform=transform)
            for i, (parts, transform) in enumerate(zip(drawn, transforms, strict=True))
            for name, mesh in _named(f"object_{i}", parts).items()
        ]
        return Scene(
            name=self.name,
            objects=(*self._panels(streams[6], background), *objects, *lights),
            cameras=self.cameras.sample(camera_rng, background.open_region),
        )

    def sample_cameras(self, scene_rng: np.random.Generator, camera_rng: np.random.Generator) -> tuple[Camera, ...]:
        """Draw only the cameras of `sample` with the same generators."""
        background = self.backgrounds.sample(scene_rng.spawn(7)[0])
        return self.cameras.sample(camera_rng, background.open_region)

    def _panels(self, rng: np.random.Generator, background: Background) -> list[SceneObject]:
        return [
            SceneObject(
                name=f"background_{i}", mesh=mesh, material=self.background_materials.sample(rng), transform=transform
            )
            for i, (mesh, transform) in enumerate(zip(background.meshes, background.transforms, strict=True))
        ]


def _named(name: str, parts: tuple[Mesh, ...]) -> dict[str, Mesh]:
    return {name: parts[0]} if len(parts) == 1 else {f"{name}_{i}": part for i, part in enumerate(parts)}
