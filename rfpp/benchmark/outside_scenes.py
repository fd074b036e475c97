"""Scenes in which light transport is hard or has a closed form, for comparison with another renderer."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
import trimesh

from rfpp.scene.mesh import Mesh
from rfpp.scene.packed import PackedScene, pack
from rfpp.scene.spec import Camera, Material, Scene, SceneObject, Transform

Vector = Sequence[float | int]
#: Faces of a box of eight corners, numbered x + 2 y + 4 z, outwards.
_BOX = [(0, 2, 3), (0, 3, 1), (4, 5, 7), (4, 7, 6), (0, 1, 5), (0, 5, 4), (2, 6, 7), (2, 7, 3), (0, 4, 6), (0, 6, 2),
        (1, 3, 7), (1, 7, 5)]  # fmt: skip


def surface(
    color: float | int | Vector, specular: float = 0.0, roughness: float = 0.5, emission: float = 0.0
) -> Material:
    """Return a material of this diffuse color."""
    diffuse = (color,) * 3 if isinstance(color, int | float) else tuple(color)
    return Material(diffuse=diffuse, specular=(specular,) * 3, roughness=roughness, emissive=(emission,) * 3)


def box(low: Vector, high: Vector) -> Mesh:
    """Return an axis-aligned box."""
    corners = np.array([[(low, high)[n >> k & 1][k] for k in range(3)] for n in range(8)], np.float32)
    return Mesh(corners, np.array(_BOX))


def sheet(corner: Vector, along: Vector, across: Vector) -> Mesh:
    """Return a parallelogram."""
    a, u, v = (np.array(x, np.float32) for x in (corner, along, across))
    return Mesh(np.stack([a, a + u, a + u + v, a + v]), np.array([(0, 1, 2), (0, 2, 3)]))


def ball(center: Vector, radius: float, smooth: int = 3) -> Mesh:
    """Return a sphere of triangles."""
    sphere = trimesh.creation.icosphere(subdivisions=smooth, radius=radius)
    return Mesh((sphere.vertices + np.array(center)).astype(np.float32), np.asarray(sphere.faces))


def room(
    low: Vector, high: Vector, color: float = 0.7, left: Vector = (0.7, 0.2, 0.2)
) -> dict[str, tuple[Mesh, Material]]:
    """Return the six walls of a closed room, the left one red."""
    (x, y, z), (w, d, h) = low, np.subtract(high, low).tolist()
    white = surface(color)
    return {
        "floor": (sheet((x, y, z), (w, 0, 0), (0, d, 0)), white),
        "ceiling": (sheet((x, y, z + h), (w, 0, 0), (0, d, 0)), white),
        "front": (sheet((x, y, z), (w, 0, 0), (0, 0, h)), white),
        "back": (sheet((x, y + d, z), (w, 0, 0), (0, 0, h)), white),
        "left": (sheet((x, y, z), (0, d, 0), (0, 0, h)), surface(left)),
        "right": (sheet((x + w, y, z), (0, d, 0), (0, 0, h)), white),
    }


def scene(name: str, parts: dict[str, tuple[Mesh, Material]], *cameras: tuple[Vector, Vector, float]) -> PackedScene:
    """Return a scene of meshes in world coordinates, with cameras of (position, target, field of view)."""
    still = Transform(normalize=False)
    objects = tuple(SceneObject(name=k, mesh=m, material=s, transform=still) for k, (m, s) in parts.items())
    views = tuple(Camera(position=tuple(p), look_at=tuple(t), fov=fov) for p, t, fov in cameras)
    return pack(Scene(name=name, objects=objects, cameras=views))


LOW, HIGH = (-0.45, -0.45, -0.45), (0.45, 0.45, 0.45)
INSIDE = ((0.0, -0.43, 0.05), (0.0, 0.2, -0.1), 80.0)
BLOCK = {"block": (box((-0.2, 0.05, -0.45), (0.1, 0.3, -0.15)), surface(0.7))}


def light_below_ceiling(gap: float) -> PackedScene:
    """A square light that hangs this far below the ceiling of a closed room and shines on both sides."""
    lamp = sheet((-0.15, -0.15, 0.45 - gap), (0.3, 0, 0), (0, 0.3, 0))
    parts = {**room(LOW, HIGH), **BLOCK, "lamp": (lamp, surface(0.0, emission=10.0))}
    return scene(f"light {gap:g} below a ceiling", parts, INSIDE)


def shaded_light() -> PackedScene:
    """A desk lamp whose shade is open downwards, in a closed room."""
    x, y, z, half, height = 0.05, 0.1, -0.05, 0.08, 0.12
    walls = {
        "shade top": sheet((x - half, y - half, z + height), (2 * half, 0, 0), (0, 2 * half, 0)),
        "shade left": sheet((x - half, y - half, z), (0, 2 * half, 0), (0, 0, height)),
        "shade right": sheet((x + half, y - half, z), (0, 2 * half, 0), (0, 0, height)),
        "shade front": sheet((x - half, y - half, z), (2 * half, 0, 0), (0, 0, height)),
        "shade back": sheet((x - half, y + half, z), (2 * half, 0, 0), (0, 0, height)),
    }
    bulb = sheet((x - 0.03, y - 0.03, z + 0.07), (0.06, 0, 0), (0, 0.06, 0))
    desk = box((-0.3, -0.1, -0.3), (0.35, 0.35, -0.27))
    parts = {**room(LOW, HIGH), "desk": (desk, surface((0.5, 0.4, 0.3))), "lamp": (bulb, surface(0.0, emission=100.0))}
    return scene("shaded desk light", parts | {k: (m, surface(0.8)) for k, m in walls.items()}, INSIDE)


def door_ajar() -> PackedScene:
    """A room lit only through a door that stands ajar."""
    parts = room(LOW, HIGH)
    thick = 0.02
    parts |= {
        "wall near": (box((0.1, -0.45, -0.45), (0.1 + thick, 0.0, 0.45)), surface(0.7)),
        "wall far": (box((0.1, 0.25, -0.45), (0.1 + thick, 0.45, 0.45)), surface(0.7)),
        "wall above": (box((0.1, 0.0, 0.2), (0.1 + thick, 0.25, 0.45)), surface(0.7)),
        "door": (sheet((0.1, 0.25, -0.45), (-0.1, -0.23, 0), (0, 0, 0.65)), surface((0.6, 0.5, 0.4))),
        "lamp": (sheet((0.2, -0.1, 0.35), (0.15, 0, 0), (0, 0.3, 0)), surface(0.0, emission=30.0)),
    }
    return scene("door ajar", parts, ((-0.3, -0.42, 0.05), (-0.05, 0.2, -0.1), 80.0))


def window() -> PackedScene:
    """A room lit through a window by a large light outside."""
    parts = room(LOW, HIGH)
    del parts["right"]
    thick, white = 0.02, surface(0.7)
    parts |= {
        "sill": (box((0.45, -0.45, -0.45), (0.45 + thick, 0.45, -0.05)), white),
        "lintel": (box((0.45, -0.45, 0.25), (0.45 + thick, 0.45, 0.45)), white),
        "jamb near": (box((0.45, -0.45, -0.05), (0.45 + thick, -0.1, 0.25)), white),
        "jamb far": (box((0.45, 0.2, -0.05), (0.45 + thick, 0.45, 0.25)), white),
        "sky": (sheet((0.9, -0.8, -0.6), (0, 1.8, 0), (0, 0, 1.8)), surface(0.0, emission=3.0)),
        **BLOCK,
    }
    return scene("window", parts, INSIDE)


def furnace(albedo: float) -> PackedScene:
    """A small ball in a box whose walls emit 1 and reflect: radiance of the ball is albedo / (1 - albedo)."""
    walls = {name: (mesh, surface(albedo, emission=1.0)) for name, (mesh, _) in room(LOW, HIGH).items()}
    parts = {**walls, "ball": (ball((0, 0, 0), 0.08), surface(albedo))}
    return scene(f"furnace, albedo {albedo:g}", parts, ((0.0, -0.4, 0.0), (0, 0, 0), 16.0))


def two_rooms() -> PackedScene:
    """A lit and a sealed dark room under one ceiling and over one floor; the second camera stands in the dark one."""
    parts = room(LOW, HIGH)
    parts |= {
        "divider": (box((-0.01, -0.45, -0.45), (0.01, 0.45, 0.45)), surface(0.7)),
        "lamp": (sheet((0.1, -0.1, 0.3), (0.2, 0, 0), (0, 0.2, 0)), surface(0.0, emission=10.0)),
    }
    lit, dark = (((x, -0.42, 0.1), (x, 0.2, -0.1), 80.0) for x in (0.2, -0.2))
    return scene("dark room beside a lit one", parts, lit, dark)


def thin_objects() -> PackedScene:
    """A table with thin legs, rods, and a sheet that stands on edge."""
    parts = room(LOW, HIGH)
    wood, white = surface((0.5, 0.35, 0.2)), surface(0.8)
    parts["table"] = (box((-0.25, -0.05, -0.15), (0.25, 0.3, -0.145)), wood)
    for number, (x, y) in enumerate([(-0.24, -0.04), (0.23, -0.04), (-0.24, 0.28), (0.23, 0.28)]):
        parts[f"leg {number}"] = (box((x, y, -0.45), (x + 0.01, y + 0.01, -0.15)), wood)
    for number in range(6):
        x = -0.15 + 0.06 * number
        parts[f"rod {number}"] = (box((x, 0.1, -0.14), (x + 0.004, 0.104, 0.15)), white)
    parts["sheet"] = (sheet((-0.35, 0.0, -0.45), (0.1, 0.3, 0), (0, 0, 0.5)), white)
    parts["lamp"] = (sheet((-0.1, -0.2, 0.35), (0.2, 0, 0), (0, 0.2, 0)), surface(0.0, emission=15.0))
    return scene("thin objects", parts, INSIDE)


def mirror_and_metal() -> PackedScene:
    """A mirror on the wall, a rough metal ball and a glossy box."""
    parts = room(LOW, HIGH)
    parts |= {
        "mirror": (sheet((-0.3, 0.44, -0.3), (0.6, 0, 0), (0, 0, 0.5)), surface(0.0, specular=0.9, roughness=0.0)),
        "metal": (ball((0.15, 0.1, -0.28), 0.17, 4), surface(0.0, specular=0.8, roughness=0.4)),
        "glossy": (
            box((-0.3, -0.05, -0.45), (-0.1, 0.15, -0.2)),
            surface((0.2, 0.3, 0.6), specular=0.2, roughness=0.3),
        ),
        "lamp": (sheet((-0.1, -0.1, 0.35), (0.2, 0, 0), (0, 0.2, 0)), surface(0.0, emission=15.0)),
    }
    return scene("mirror and rough metal", parts, INSIDE)


def twelve_lights() -> PackedScene:
    """A room under twelve small lights."""
    parts = {**room(LOW, HIGH), **BLOCK}
    for number in range(12):
        x, y = -0.35 + 0.2 * (number % 4), -0.3 + 0.25 * (number // 4)
        lamp = sheet((x, y, 0.3 + 0.02 * (number % 3)), (0.05, 0, 0), (0, 0.05, 0))
        parts[f"lamp {number}"] = (lamp, surface(0.0, emission=10.0 + 4 * number))
    return scene("twelve lights", parts, INSIDE)


#: Class of scenes → constructors.
SCENES: dict[str, list[Callable[[], PackedScene]]] = {
    "light near a ceiling": [lambda gap=gap: light_below_ceiling(gap) for gap in (0.005, 0.02, 0.1, 0.3)],
    "shaded light": [shaded_light],
    "door ajar": [door_ajar],
    "window": [window],
    "furnace": [lambda albedo=albedo: furnace(albedo) for albedo in (0.5, 0.8)],
    "two rooms": [two_rooms],
    "thin objects": [thin_objects],
    "mirror and metal": [mirror_and_metal],
    "twelve lights": [twelve_lights],
}


def outside_scenes() -> Iterator[tuple[str, PackedScene]]:
    """Yield (class, scene) of every scene."""
    for kind, makers in SCENES.items():
        for make in makers:
            yield kind, make()
