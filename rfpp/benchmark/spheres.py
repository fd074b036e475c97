"""Scenes of exactly so many triangles and objects that are real enough to cast rays into: spheres under a lamp."""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.spatial import ConvexHull

from rfpp.errors import UserError
from rfpp.scene.mesh import Mesh
from rfpp.scene.spec import Camera, Material, Scene, SceneObject, Transform

#: The lamp's name.
LAMP = "lamp"
#: A square above the scene, which faces it.
_LAMP = Mesh(
    np.array([[-0.2, -0.2, 1], [-0.2, 0.2, 1], [0.2, 0.2, 1], [0.2, -0.2, 1]]), np.array([[0, 1, 2], [0, 2, 3]])
)
_GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))


def spheres(triangles: int, objects: int, views: int, seed: int) -> Scene:
    """Spheres on a grid of random gaps and a lamp of two triangles, seen by cameras around them.

    Args:
        triangles, objects: of the scene, lamp included.

    Raises:
        UserError: the triangles cannot be shared out.
    """
    pairs, count = triangles // 2 - 1, objects - 1
    if triangles % 2 or count < 1 or pairs < 2 * count:
        raise UserError(
            f"{triangles} triangles in {objects} objects: ask for an even number of triangles and two objects or more, "
            "with four triangles or more in each"
        )
    rng = np.random.default_rng(seed)
    cells = int(np.ceil(count ** (1 / 3)))
    places = rng.permutation(list(product(range(cells), repeat=3)))[:count]
    sizes = [2 * (pairs // count + (number < pairs % count)) for number in range(count)]
    shapes = {size: sphere(size) for size in set(sizes)}
    items = [
        SceneObject(
            name=f"sphere_{number}",
            mesh=shapes[size],
            material=_material(rng),
            transform=Transform(
                normalize=False,
                scale=(float(rng.uniform(0.25, 0.45)) / cells,) * 3,
                translation=tuple(((place + rng.uniform(0.45, 0.55, 3)) / cells - 0.5).tolist()),
            ),
        )
        for number, (place, size) in enumerate(zip(places, sizes, strict=True))
    ]
    lamp = Material(diffuse=(1.0,) * 3, specular=(0.0,) * 3, roughness=1.0, emissive=(20.0,) * 3)
    items.append(SceneObject(name=LAMP, mesh=_LAMP, material=lamp, transform=Transform(normalize=False)))
    return Scene(name="spheres", objects=tuple(items), cameras=tuple(camera(i / views) for i in range(views)))


def sphere(triangles: int) -> Mesh:
    """A sphere of radius 1 with this even number of triangles: the convex hull of v points has 2v - 4."""
    points = triangles // 2 + 2
    height = 1 - (2 * np.arange(points) + 1) / points
    angle = _GOLDEN_ANGLE * np.arange(points)
    vertices = np.stack([np.cos(angle), np.sin(angle), height], axis=-1)
    vertices[:, :2] *= np.sqrt(1 - height**2)[:, None]
    faces = ConvexHull(vertices).simplices
    corners = vertices[faces]
    inwards = (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) * corners[:, 0]).sum(-1) < 0
    faces[inwards] = faces[inwards, ::-1]
    return Mesh(vertices, faces)


def camera(turn: float) -> Camera:
    """Looks at the scene from so much of a turn around it."""
    angle = 2 * np.pi * turn
    return Camera(position=(float(1.7 * np.sin(angle)), float(-1.7 * np.cos(angle)), 0.6), look_at=(0, 0, 0), fov=40)


def _material(rng: np.random.Generator) -> Material:
    return Material(
        diffuse=tuple(rng.uniform(0.1, 0.7, 3).tolist()),
        specular=(0.2,) * 3,
        roughness=float(rng.uniform(0.1, 0.9)),
        smooth_shading=True,
    )
