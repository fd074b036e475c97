"""Lights of imported scenes: punctual lights become emissive triangles, and dark scenes get additional lights.

- Point light: a tetrahedron with edges of 0.05 and radiance 4 · intensity / surface; exact in the mean over directions,
  within 18% in each.
- Spot light: one triangle with edges of 0.05 facing its direction, with radiance intensity / area; exact along the
  axis. It falls off as a cosine instead of at a cone, and shines to the front only.
- Directional light: one triangle with edges of 0.16, 2.4 from the origin and facing it, with radiance irradiance · 2.4²
  / area; exact at the origin.

The brightness of a scene is the mean unoccluded irradiance of its surfaces. Below a fiftieth of the brightness of
training scenes, three lights are added around the first camera; above twenty times that, lights are dimmed to it.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from rfpp.scene.io.imported_scene import ImportedScene, Part, PunctualLight
from rfpp.scene.spec import Camera
from rfpp.scene.triangles import EMISSION

#: Mean unoccluded irradiance of the example scenes, which are lit like training scenes.
USUAL = 2.2
_FAINT, _DAZZLING = USUAL / 50, USUAL * 20

_LAMP_EDGE, _LIGHT_EDGE, _LIGHT_DISTANCE = 0.05, 0.16, 2.4
_TETRAHEDRON = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(8)  # edges of 1
_SIDES = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])

#: Azimuth relative to the camera and elevation in degrees, radiance: white walls inside the box stay below 1.
_RIG = (("key_light", 45.0, 50.0, 600.0), ("fill_light", -60.0, 35.0, 330.0), ("back_light", 170.0, 60.0, 160.0))
_SAMPLES = 512


def with_lights(scene: ImportedScene, camera: Camera, path: Path) -> list[Part]:
    """Return the parts of a framed scene and its lights; added lights are placed around `camera`."""
    parts = [*scene.parts, *map(emitter, scene.punctual_lights)]
    glowing = sum(part.is_light for part in scene.parts)
    if glowing:
        warnings.warn(
            f"{path}: emissive parts light the scene and are invisible to the camera ({glowing})", stacklevel=4
        )
    if approximate := sum(light.kind != "point" for light in scene.punctual_lights):
        warnings.warn(f"{path}: spot and directional lights became triangles, which shine more widely ({approximate})",
                      stacklevel=4)  # fmt: skip
    brightness = irradiance(parts)
    if brightness < _FAINT:
        why = f"its brightness is {brightness / USUAL:.1%} of training scenes'" if brightness else "it has no light"
        warnings.warn(f"{path}: {why}: three lights are added", stacklevel=4)
        parts += [_rig_light(camera, *values) for values in _RIG]
    elif brightness > _DAZZLING:
        factor = USUAL / brightness
        warnings.warn(
            f"{path}: its lights are scaled by {factor:.3g} to the brightness of training scenes", stacklevel=4
        )
        parts = [_dimmed(part, factor) for part in parts]
    return parts


def emitter(light: PunctualLight) -> Part:
    """Return the triangles that replace a light."""
    if light.kind == "point":
        surface = np.sqrt(3) * _LAMP_EDGE**2
        return _light(light.name, light.position + _LAMP_EDGE * _TETRAHEDRON, _SIDES, 4 * light.strength / surface)
    if light.kind == "spot":
        position, edge, radiance = light.position, _LAMP_EDGE, light.strength / _area(_LAMP_EDGE)
    else:
        position, edge = -_LIGHT_DISTANCE * light.direction, _LIGHT_EDGE
        radiance = light.strength * _LIGHT_DISTANCE**2 / _area(_LIGHT_EDGE)
    return replace(_triangle(light.name, position, light.direction, edge, radiance), one_sided=True)


def irradiance(parts: Sequence[Part]) -> float:
    """Return the mean unoccluded irradiance of the surfaces from all lights, averaged over colors."""
    surfaces, lights = ([p for p in parts if p.is_light == is_light and len(p)] for is_light in (False, True))
    if not surfaces or not lights:
        return 0.0
    rng = np.random.default_rng(0)
    points, normals, *_ = _sampled(rng, surfaces, [part.areas for part in surfaces])
    power = [part.areas * part.material[:, EMISSION].mean(axis=1, dtype=np.float64) for part in lights]
    places, facing, is_one_sided, each = _sampled(rng, lights, power)
    towards = places - points[:, None]
    squared = np.maximum((towards**2).sum(-1), 1e-4)
    leaving = -(towards * facing).sum(-1)
    leaving = np.where(is_one_sided, np.maximum(leaving, 0), np.abs(leaving))
    cosines = np.abs((towards * normals[:, None]).sum(-1)) * leaving / squared
    return float((each * cosines / squared).sum(axis=1).mean())


def _sampled(
    rng: np.random.Generator, parts: Sequence[Part], weights: Sequence[np.ndarray]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"], float]:
    """Draw faces by weight; return centers, unit normals, whether they are one-sided, and the weight of each draw."""
    weight = np.concatenate(weights)
    if not weight.sum() > 0:
        return np.zeros((1, 3)), np.zeros((1, 3)), np.zeros(1, bool), 0.0
    chosen = rng.choice(len(weight), _SAMPLES, p=weight / weight.sum())
    corners = np.concatenate([part.corners for part in parts])[chosen]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), np.finfo(float).tiny)
    is_one_sided = np.repeat([part.one_sided for part in parts], [len(part) for part in parts])[chosen]
    return corners.mean(axis=1), normals / lengths, is_one_sided, weight.sum() / _SAMPLES


def _rig_light(camera: Camera, name: str, azimuth: float, elevation: float, radiance: float) -> Part:
    x, y = np.subtract(camera.position, camera.look_at)[:2]
    around, above = np.arctan2(y, x) + np.radians(azimuth), np.radians(elevation)
    towards = np.array([np.cos(above) * np.cos(around), np.cos(above) * np.sin(around), np.sin(above)])
    return _triangle(name, _LIGHT_DISTANCE * towards, towards, _LIGHT_EDGE, np.full(3, radiance))


def _triangle(name: str, center: np.ndarray, normal: np.ndarray, edge: float, radiance: np.ndarray) -> Part:
    aside = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    aside /= np.linalg.norm(aside)
    angles = np.radians([0, 120, 240])[:, None]
    corners = np.cos(angles) * aside + np.sin(angles) * np.cross(normal, aside)
    return _light(name, center + edge / np.sqrt(3) * corners, np.array([[0, 1, 2]]), radiance)


def _light(name: str, vertices: np.ndarray, faces: np.ndarray, radiance: np.ndarray) -> Part:
    row = np.array([1, 1, 1, 0, 0, 0, 1, *radiance], np.float32)  # white and diffuse, as in training scenes
    return Part(name, vertices, faces, np.tile(row, (len(faces), 1)), smooth=False)


def _area(edge: float) -> float:
    return np.sqrt(3) / 4 * edge**2


def _dimmed(part: Part, factor: float) -> Part:
    material = part.material.copy()
    material[:, EMISSION] *= factor
    return replace(part, material=material)
