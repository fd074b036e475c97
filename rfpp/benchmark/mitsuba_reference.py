"""Reference images by Mitsuba 3, a renderer that shares no code with Blender or this project."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from jaxtyping import Float
from scipy.ndimage import binary_dilation

from rfpp.raycast.raycast import RayCaster
from rfpp.scene.camera import pixel_plane
from rfpp.scene.packed import PackedScene
from rfpp.scene.triangles import DIFFUSE, EMISSION, ROUGHNESS, SPECULAR

#: From Mitsuba's camera, which looks along +Z with +X to the left, to ours.
_AXES = np.diag([-1.0, 1.0, -1.0, 1.0])
#: Distance between the two one-sided copies of a light that shines on both sides.
_BETWEEN = 2e-4


def render(scene: PackedScene, resolution: int, samples: int, seed: int = 0) -> Float[np.ndarray, "v h w 3"]:
    """Path-trace a scene of constant materials per object, with light paths of any length."""
    import mitsuba  # optional

    mitsuba.set_variant("scalar_rgb")
    described = {"type": "scene", "integrator": {"type": "path", "max_depth": -1, "rr_depth": 16}}
    loaded = mitsuba.load_dict(described | _shapes(mitsuba, scene))
    images = []
    for c2w, fov in zip(scene.c2w, scene.fov, strict=True):
        sensor = mitsuba.load_dict(
            {
                "type": "perspective",
                "fov": float(fov),
                "to_world": mitsuba.ScalarTransform4f((c2w.astype(np.float64) @ _AXES).tolist()),
                "film": {
                    "type": "hdrfilm", "width": resolution, "height": resolution, "pixel_format": "rgb",
                    "rfilter": {"type": "box"},
                },
                "sampler": {"type": "independent", "sample_count": samples},
            }
        )  # fmt: skip
        images.append(np.array(mitsuba.render(loaded, sensor=sensor, spp=samples, seed=seed), np.float32))
    return np.stack(images)


def sees_emitters(scene: PackedScene, view: int, resolution: int) -> np.ndarray:
    """Return a mask [H, W] of the pixels in or beside which Mitsuba shows a light, which our cameras look through."""
    c2w = scene.c2w[view].astype(np.float64)
    plane = pixel_plane(resolution, resolution).reshape(-1, 2) * np.tan(np.radians(float(scene.fov[view])) / 2)
    directions = np.concatenate([plane, -np.ones((len(plane), 1))], axis=1) @ c2w[:3, :3].T
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    hit = RayCaster(scene.triangles.positions).cast(np.tile(c2w[:3, 3], (len(plane), 1)), directions).triangle
    emissive = np.append(scene.triangles.is_emissive, False)[hit].reshape(resolution, resolution)
    return binary_dilation(emissive, np.ones((3, 3)))


def _shapes(mitsuba, scene: PackedScene) -> dict[str, object]:
    triangles, shapes = scene.triangles, {}
    for number, (first, last) in enumerate(pairwise(triangles.object_offsets.tolist())):
        material, corners = triangles.material[first], triangles.positions[first:last]
        emission = material[EMISSION]
        if emission.any() and triangles.object_names[number] not in triangles.one_sided:
            cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            normal = cross / np.linalg.norm(cross, axis=-1, keepdims=True)
            shift = _BETWEEN / 2 * normal[:, None]
            sides = {"front": corners + shift, "back": (corners - shift)[:, ::-1]}
        else:
            sides = {"both": corners}
        for side, positions in sides.items():
            shape = _mesh(mitsuba, positions, material, emission)
            shapes[f"object_{number}_{side}"] = shape
    return shapes


def _mesh(mitsuba, positions: Float[np.ndarray, "m 3 3"], material: np.ndarray, emission: np.ndarray):
    properties = mitsuba.Properties()
    properties["bsdf"] = mitsuba.load_dict(_bsdf(material))
    if emission.any():
        radiance = {"type": "rgb", "value": emission.tolist()}
        properties["emitter"] = mitsuba.load_dict({"type": "area", "radiance": radiance})
    mesh = mitsuba.Mesh("mesh", 3 * len(positions), len(positions), props=properties)
    parameters = mitsuba.traverse(mesh)
    parameters["vertex_positions"] = np.ravel(positions).astype(np.float32)
    parameters["faces"] = np.arange(3 * len(positions), dtype=np.uint32)
    parameters.update()
    return mesh


def _bsdf(material: np.ndarray) -> dict[str, object]:
    """Return the sum of a diffuse and a GGX lobe, as a blend of both."""
    diffuse, specular, roughness = material[DIFFUSE], material[SPECULAR], float(material[ROUGHNESS][0])
    share = float(specular.mean() / max(specular.mean() + diffuse.mean(), 1e-9))

    def rgb(color: np.ndarray, weight: float) -> dict[str, object]:
        return {"type": "rgb", "value": np.clip(color / max(weight, 1e-9), 0, 1).tolist()}

    lambertian = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": rgb(diffuse, 1 - share)}}
    rough = {"type": "roughconductor", "distribution": "ggx", "alpha": roughness**2}
    kind = rough if roughness > 0.03 else {"type": "conductor"}
    glossy = {"type": "twosided", "bsdf": kind | {"material": "none", "specular_reflectance": rgb(specular, share)}}
    if share == 0:
        return lambertian
    if share == 1:
        return glossy
    return {"type": "blendbsdf", "weight": share, "first": lambertian, "second": glossy}
