"""Export samples as RenderFormer JSON or H5, or as EXR images.

Every function writes into a folder, under the name of the sample, and returns the paths.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import SupportsFloat

import numpy as np
from jaxtyping import Float

from rfpp.errors import SceneError, UserError
from rfpp.imaging.exr import write_exr
from rfpp.imaging.panels import save_picture, tone_mapped
from rfpp.raycast.direct_light import direct_radiance
from rfpp.raycast.first_hit import channel, object_ids
from rfpp.scene.io.renderformer_h5 import save_h5
from rfpp.scene.io.renderformer_json import save_json
from rfpp.scene.mesh import Mesh
from rfpp.scene.packed import PackedScene
from rfpp.scene.shading_normals import corner_normals
from rfpp.scene.spec import Camera, Material, Scene, SceneObject, Transform
from rfpp.scene.triangles import DIFFUSE, EMISSION, ROUGHNESS, SPECULAR, SceneTriangles
from rfpp.shards.sample import SceneSample

_IN_PLACE = Transform(normalize=False)


def export(sample: SceneSample, format: str, folder: Path) -> list[Path]:
    """Write a sample in one of `FORMATS`. Raises UserError for an unknown format or a file that cannot be written."""
    if format not in FORMATS:
        raise UserError(f"format={format}: choose from {', '.join(FORMATS)}")
    return FORMATS[format](sample, Path(folder))


def export_renderformer(sample: SceneSample, folder: Path) -> list[Path]:
    """Write RenderFormer JSON v1.0 with one mesh per object, and the images of `export_exr`, also as PNG.

    `load_scene` restores positions and materials exactly and cameras to float32. The format stores only whether an
    object is flat or smooth, so the closer of the two replaces the sample's normals; generated scenes lose nothing.
    An object of several materials becomes one object per material. Triangles without area are omitted.
    """
    scene = save_json(as_scene(sample), folder / f"{sample.key}.json")
    pictures = [
        save_picture(tone_mapped(image), folder / f"{sample.key}.view{view}.png")
        for view, image in enumerate(sample.images)
    ]
    return [scene, *export_exr(sample, folder), *pictures]


def export_h5(sample: SceneSample, folder: Path) -> list[Path]:
    """Write RenderFormer's H5 training format (`rfpp.scene.io.renderformer_h5`) with materials and images in half."""
    packed = PackedScene(sample.key, sample.triangles, sample.c2w, sample.fov)
    return [save_h5(packed, folder / f"{sample.key}.h5", sample.images)]


def export_exr(sample: SceneSample, folder: Path) -> list[Path]:
    """Write a multi-layer EXR per view; HDR viewers show its reference image.

    Half precision, except float32 `depth` and `direct`. `triangle` and `object` count from 1; 0 means nothing is hit.
    `direct` is the radiance of the first bounce; other layers are as in `rfpp.raycast.first_hit.CHANNELS`.
    """
    return [
        write_exr(folder / f"{sample.key}.view{view}.exr", _layers(sample, view)) for view in range(len(sample.images))
    ]


#: Name on the command line → writer.
FORMATS: Mapping[str, Callable[[SceneSample, Path], list[Path]]] = {
    "renderformer": export_renderformer,
    "h5": export_h5,
    "exr": export_exr,
}


def as_scene(sample: SceneSample) -> Scene:
    """Return a scene with meshes in world space and look-at cameras, as described in `export_renderformer`."""
    cameras = tuple(look_at(pose, fov) for pose, fov in zip(sample.c2w, sample.fov, strict=True))
    return Scene(name=sample.key, objects=tuple(_objects(sample.triangles)), cameras=cameras)


def look_at(c2w: Float[np.ndarray, "4 4"], fov: SupportsFloat) -> Camera:
    """Return the camera whose `camera_to_world` is this pose."""
    _, up, backward, position = c2w[:3].astype(np.float64).T
    return Camera(
        position=tuple(position.tolist()),
        look_at=tuple((position - backward).tolist()),
        up=tuple(up.tolist()),
        fov=float(fov),
    )


def _objects(triangles: SceneTriangles) -> Iterator[SceneObject]:
    for index, name in enumerate(triangles.object_names):
        rows = np.arange(*triangles.object_offsets[index : index + 2])
        rows = rows[_areas(triangles.positions[rows]) > 0]
        materials, part = np.unique(triangles.material[rows], axis=0, return_inverse=True)
        for number, material in enumerate(materials):
            part_name = name if len(materials) == 1 else f"{name}_material_{number}"
            mine = rows[part.reshape(-1) == number]
            try:
                yield _object(part_name, triangles.positions[mine], triangles.normals[mine], material)
            except SceneError as error:
                raise SceneError(f"object '{part_name}': {error}") from None


def _object(
    name: str, corners: Float[np.ndarray, "f 3 3"], normals: Float[np.ndarray, "f 3 3"], material: np.ndarray
) -> SceneObject:
    vertices, faces = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    mesh = Mesh(vertices, faces.reshape(-1, 3))
    flat_error, smooth_error = (np.abs(corner_normals(mesh, smooth) - normals).mean() for smooth in (False, True))
    diffuse, specular, emissive = (tuple(material[columns].tolist()) for columns in (DIFFUSE, SPECULAR, EMISSION))
    return SceneObject(
        name=name,
        mesh=mesh,
        transform=_IN_PLACE,
        material=Material(
            diffuse=diffuse,
            specular=specular,
            roughness=material[ROUGHNESS].item(),
            emissive=emissive,
            smooth_shading=bool(smooth_error < flat_error),
        ),
    )


def _areas(corners: Float[np.ndarray, "f 3 3"]) -> Float[np.ndarray, " f"]:
    edges = corners[:, 1:].astype(np.float64) - corners[:, :1]
    return np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=-1) / 2


def _layers(sample: SceneSample, view: int) -> dict[str, np.ndarray]:
    gbuffer, material, fov = sample.gbuffers[view], sample.triangles.material, sample.fov[view]
    albedo, specular, roughness = (channel(gbuffer, material, fov, n) for n in ("albedo", "specular", "roughness"))
    radiance_and_surface = {
        "RGB": sample.images[view],
        "direct_diffuse": gbuffer.light.diffuse,
        "direct_glossy": gbuffer.light.glossy,
        "reflected_light": gbuffer.reflection.light,
        "normal": gbuffer.normal,
        "albedo": albedo,
        "specular": specular,
        "roughness": roughness[..., 0],
    }
    return {
        **{name: layer.astype(np.float16) for name, layer in radiance_and_surface.items()},
        "direct": direct_radiance(gbuffer, material).astype(np.float32),
        "depth": gbuffer.depth,
        "triangle": (gbuffer.triangle + 1).astype(np.uint32),
        "object": (object_ids(gbuffer, sample.triangles) + 1).astype(np.uint32),
    }
