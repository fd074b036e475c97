"""Random scene families: backgrounds, objects, materials, lights and cameras put together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from rfpp.errors import SceneError
from rfpp.scene.mesh import Mesh, joined
from rfpp.scene.sampling.backgrounds import Background, BackgroundSampler
from rfpp.scene.sampling.cameras import CameraSampler
from rfpp.scene.sampling.interval import Interval, freeze_intervals, uniform_integer
from rfpp.scene.sampling.lights import LightSampler
from rfpp.scene.sampling.materials import MaterialSampler
from rfpp.scene.sampling.objects.object_source import ObjectSource
from rfpp.scene.sampling.placement import Placement
from rfpp.scene.spec import Camera, Scene, SceneObject


@dataclass(frozen=True)
class TriangleBudget:
    """How many triangles a scene has, and how many of them each object gets.

    Attributes:
        scene: triangles of a scene, with its background and lights.
        objects: objects of a scene, without its background and lights.
        per_object: triangles of an object.
    """

    scene: Interval
    objects: Interval
    per_object: Interval

    def __post_init__(self) -> None:
        freeze_intervals(self)

    def sample(self, rng: np.random.Generator, taken: int) -> Int[np.ndarray, " objects"]:
        """Even triangle counts of the objects of one scene in which `taken` triangles are spoken for.

        The scene's total is uniform over what the three intervals allow, the number of objects uniform over what the
        total allows; the objects share the rest, unevenly.

        Raises:
            SceneError: the intervals contradict one another.
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
    """`count` random even numbers in [smallest, largest] (both even) that add up to `total`, or one less if it is odd.

    They are smallest + (largest - smallest) · uᵞ with independent uniform u and the γ that gives the sum: uniform if
    the total is the middle one, bunched towards an end otherwise.
    """
    u = rng.uniform(1e-6, 1 - 1e-6, count)
    low, high = -20.0, 20.0  # of log γ, far beyond what float64 can tell from "all largest" and "all smallest"
    for _ in range(60):
        middle = (low + high) / 2
        numbers = smallest + (largest - smallest) * u ** np.exp(middle)
        low, high = (middle, high) if numbers.sum() > total else (low, middle)
    # Rounding the running sum keeps the total and moves no number by more than two.
    return np.diff(np.round(np.cumsum(numbers)).astype(np.int64) // 2 * 2, prepend=0)


@dataclass(frozen=True)
class SceneFamily:
    """A distribution over scenes.

    Geometry, materials and lights come from one rng and cameras from another, so that a scene can be seen again from
    new viewpoints. Every component has its own stream: changing one leaves the draws of the others as they were.

    Attributes:
        name: of the family; scenes are called after it.
        objects: source of object meshes.
        budget: number of objects and of triangles.
        placement: where the objects stand.
        materials: of the objects.
        background_materials: of floor and walls.
        backgrounds, lights, cameras: see there.
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
        """A scene: background panels, then objects, then lights, named background_0, object_0, light_0 and so on.

        Of an object in several parts each is one of the scene's objects, named object_0_0, object_0_1 and so on.

        Objects come from those that are held out for test scenes, or from all others. The same generators give the
        same scene. Raises SceneError where the family's numbers contradict one another.
        """
        streams = scene_rng.spawn(7)
        background = self.backgrounds.sample(streams[0])
        lights = self.lights.sample(streams[1], background.open_region)
        targets = self.budget.sample(streams[2], taken=background.triangle_count + len(lights))
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
        """The cameras alone of `sample` with the same generators, at no more cost than theirs."""
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
