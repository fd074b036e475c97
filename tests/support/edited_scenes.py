"""A small scene of several objects and lights, and what a user may do to it."""

import numpy as np
from small_data import FLOOR, LIGHT, PEAK

from rfpp.scene.spec import Camera, Material, Scene, SceneObject, Transform

MATTE = Material(diffuse=(0.5, 0.4, 0.3), specular=(0.2,) * 3, roughness=0.4)


def lamp(power: float) -> Material:
    """A material that emits this radiance."""
    return Material(diffuse=(1.0,) * 3, specular=(0.0,) * 3, roughness=1.0, emissive=(power,) * 3)


def scene() -> Scene:
    """A floor, three peaks and two lights, seen by three cameras."""
    parts = [("floor", FLOOR, MATTE, (0, 0, 0)), ("lamp", LIGHT, lamp(3000), (0, 0, 0))]
    parts += [(f"peak_{i}", PEAK, MATTE, (0.3 * i - 0.3, 0.1 * i, 0.05)) for i in range(3)]
    parts += [("spot", LIGHT, lamp(700), (0.5, 0.4, -0.3))]
    objects = [
        SceneObject(name=name, mesh=mesh, material=material, transform=Transform(normalize=False, translation=place))
        for name, mesh, material, place in parts
    ]
    cameras = [Camera(position=(x, -1.2, 0.8), look_at=(0, 0, 0), fov=45) for x in (-0.4, 0.1, 0.5)]
    return Scene(name="six", objects=tuple(objects), cameras=tuple(cameras))


def changed(before: Scene, name: str, **parts) -> Scene:
    """One object with other parts."""
    objects = tuple(o.model_copy(update=parts) if o.name == name else o for o in before.objects)
    return before.model_copy(update={"objects": objects})


def with_objects(before: Scene, objects) -> Scene:
    return before.model_copy(update={"objects": tuple(objects)})


def moved(before: Scene) -> Scene:
    return changed(before, "peak_1", transform=Transform(normalize=False, translation=(0.1, -0.3, 0.2)))


def recolored(before: Scene) -> Scene:
    return changed(before, "peak_1", material=MATTE.model_copy(update={"diffuse": (0.1, 0.7, 0.2)}))


def dimmed(before: Scene) -> Scene:
    return changed(before, "lamp", material=lamp(1100))


def removed(before: Scene) -> Scene:
    return with_objects(before, [o for o in before.objects if o.name != "peak_0"])


def reordered(before: Scene) -> Scene:
    return with_objects(before, np.array(before.objects, dtype=object)[[3, 5, 0, 4, 1, 2]])


def added(before: Scene) -> Scene:
    place = Transform(normalize=False, translation=(-0.1, -0.4, 0.1))
    extra = SceneObject(name="extra", mesh=PEAK, material=MATTE, transform=place)
    return with_objects(before, [*before.objects[:2], extra, *before.objects[2:]])
