"""Folders of good and bad mesh files, and sources of objects that read them."""

from pathlib import Path

import numpy as np
import trimesh

from rfpp.scene.sampling.objects.folder import FolderObjects
from rfpp.scene.sampling.objects.library import Library
from rfpp.scene.sampling.objects.library_building import prepare
from rfpp.scene.sampling.objects.preparation import Preparation

GOOD = ("ball.obj", "rings/ring.ply", "rings/deep/capsule.stl", "table.glb", "box.gltf", "cone.OBJ")


def fill(folder: Path) -> Path:
    """Six good meshes in every format, the finest of 5120 faces and the coarsest of 12."""
    (folder / "rings" / "deep").mkdir(parents=True)
    trimesh.creation.icosphere(4).export(folder / "ball.obj")
    trimesh.creation.torus(1, 0.3).export(folder / "rings" / "ring.ply")
    trimesh.creation.capsule(2, 0.5).export(folder / "rings" / "deep" / "capsule.stl")
    table().export(folder / "table.glb")
    trimesh.Scene(trimesh.creation.box((1, 2, 3))).export(str(folder / "box.gltf"), merge_buffers=True)
    (folder / "cone.OBJ").write_text(trimesh.creation.cone(1, 2, sections=40).export(file_type="obj"))
    (folder / "readme.txt").write_text("no mesh")
    return folder


def table() -> trimesh.Scene:
    """Four legs, one geometry in four places, and a top that a node has turned and moved: 3 × 3 × 2.2."""
    scene = trimesh.Scene()
    for x in (-1, 1):
        for y in (-1, 1):
            at = trimesh.transformations.translation_matrix((x, y, 1))
            scene.add_geometry(trimesh.creation.box((0.2, 0.2, 2)), geom_name="leg", transform=at)
    turned = trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0))
    turned[:3, 3] = (0, 0, 2.1)
    scene.add_geometry(trimesh.creation.box((3, 0.2, 3)), geom_name="top", transform=turned)
    return scene


def bowl() -> trimesh.Trimesh:
    """A ball without its cap."""
    ball = trimesh.creation.icosphere(3)
    return trimesh.Trimesh(ball.vertices, ball.faces[ball.triangles_center[:, 2] < 0.2])


def source(folder: Path, root: Path, held_out: float = 0.4, **preparation) -> FolderObjects:
    settings = {"max_faces": 400, "min_faces": 4, "non_watertight": "reject", "most_parts": 1, "up": "z"} | preparation
    return FolderObjects(str(root), held_out, Preparation(**settings), str(folder))


def one_by_one(job, items):
    """Apply the job to each item in this process."""
    return ((item, job(item)) for item in items)


def prepared(objects: FolderObjects) -> Library:
    return prepare(objects, one_by_one, lambda done, total: None)


def write_obj(path, *groups):
    """Write (material, mesh) pairs to an OBJ file without an MTL file."""
    lines, start = [], 1
    for material, mesh in groups:
        lines += [f"v {x} {y} {z}" for x, y, z in mesh.vertices] + [f"usemtl {material}"]
        lines += [f"f {a} {b} {c}" for a, b, c in mesh.faces + start]
        start += len(mesh.vertices)
    path.write_text("\n".join(lines) + "\n")
    return path


def box(size, at=(0, 0, 0)):
    return trimesh.creation.box(size, trimesh.transformations.translation_matrix(at))
