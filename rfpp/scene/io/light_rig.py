"""Light of imported scenes: lights without extent become triangles, and dark scenes get additional lights.

The brightness of a scene is the mean unoccluded irradiance of its surfaces. Below a fiftieth of the brightness of
training scenes, three lights are added around the first camera; above twenty times that, lights are dimmed to it.

Added lights stand 2.4 from the origin. Where a surface stands between such a light and the center of the view, as in a
closed room, the light moves towards that center, to three fifths of the free distance; it shrinks alike, so that the
center stays as bright.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from rfpp.scene.io.grouping import joined
from rfpp.scene.io.imported_scene import ImportedScene, Part
from rfpp.scene.io.punctual_lights import facing_triangle, fixture, separate
from rfpp.scene.spec import Camera
from rfpp.scene.triangles import EMISSION

#: Mean unoccluded irradiance of the example scenes, which are lit like training scenes.
USUAL = 2.2
_FAINT, _DAZZLING = USUAL / 50, USUAL * 20

_LIGHT_EDGE, _LIGHT_DISTANCE, _NEARER = 0.16, 2.4, 0.6

#: Azimuth relative to the camera and elevation in degrees, radiance: white walls inside the box stay below 1.
_RIG = (("key_light", 45.0, 50.0, 600.0), ("fill_light", -60.0, 35.0, 330.0), ("back_light", 170.0, 60.0, 160.0))
_SAMPLES = 512


def with_lights(scene: ImportedScene, camera: Camera, path: Path) -> list[Part]:
    """Return the parts of a framed scene and its lights; added lights are placed around `camera`."""
    lights = separate(scene.punctual_lights)
    if joined_lights := len(scene.punctual_lights) - len(lights):
        warnings.warn(f"{path}: point lights that touch others are joined to these ({joined_lights})", stacklevel=4)
    parts = [*scene.parts, *(part for light in lights for part in fixture(light))]
    glowing = sum(part.is_light for part in scene.parts)
    if glowing:
        warnings.warn(
            f"{path}: emissive parts light the scene and are invisible to the camera ({glowing})", stacklevel=4
        )
    if spots := sum(light.kind == "spot" for light in scene.punctual_lights):
        warnings.warn(f"{path}: spot lights shine from black shades, which the camera can see ({spots})", stacklevel=4)
    brightness = irradiance(parts)
    if brightness < _FAINT:
        why = f"its brightness is {brightness / USUAL:.1%} of training scenes'" if brightness else "it has no light"
        rig, blocked = _rig(camera, parts)
        where = ", in front of what would block them" if blocked else ""
        warnings.warn(f"{path}: {why}: three lights are added{where}", stacklevel=4)
        parts += rig
    elif brightness > _DAZZLING:
        factor = USUAL / brightness
        warnings.warn(
            f"{path}: its lights are scaled by {factor:.3g} to the brightness of training scenes", stacklevel=4
        )
        parts = [_dimmed(part, factor) for part in parts]
    return parts


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


def _rig(camera: Camera, parts: Sequence[Part]) -> tuple[list[Part], bool]:
    """Return three lights, and whether any of them had to move."""
    surface = joined([part for part in parts if not part.is_light])
    position = np.array(camera.position, np.float64)
    forward = np.subtract(camera.look_at, position)
    forward /= np.linalg.norm(forward)
    center = position + min(_free_distance(surface, position, forward), _LIGHT_DISTANCE) / 2 * forward
    lights, blocked = [], False
    x, y = -forward[:2]
    for name, azimuth, elevation, radiance in _RIG:
        around, above = np.arctan2(y, x) + np.radians(azimuth), np.radians(elevation)
        outward = np.array([np.cos(above) * np.cos(around), np.cos(above) * np.sin(around), np.sin(above)])
        place, size = _LIGHT_DISTANCE * outward, 1.0
        away = place - center
        if (free := _free_distance(surface, center, away)) < 1:
            size, blocked = _NEARER * free, True
            place = center + size * away
        triangle = facing_triangle(name, place, -outward, size * _LIGHT_EDGE, np.full(3, radiance))
        lights.append(replace(triangle, one_sided=False))
    return lights, blocked


def _free_distance(surface: Part, origin: np.ndarray, direction: np.ndarray) -> float:
    """Return the distance to the first triangle along a ray, in lengths of its direction; infinity for none."""
    across, faces = np.cross(direction, np.eye(3)[np.abs(direction).argmin()]), surface.faces
    for normal in (across, np.cross(direction, across)):  # only triangles that both planes cut can be hit
        a, b, c = (surface.vertices @ normal > origin @ normal)[faces].T
        faces = faces[(a != b) | (b != c)]
    return _first_distance(surface.vertices[faces], origin, direction)


def _first_distance(corners: Float[np.ndarray, "f 3 3"], origin: np.ndarray, direction: np.ndarray) -> float:
    with np.errstate(divide="ignore", invalid="ignore"):  # of triangles without area and those seen from their edge
        a, b, c = corners[:, 0] - origin, corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        across = np.cross(direction, c)
        inverse = 1 / (b * across).sum(-1)
        turned = np.cross(-a, b)
        u, v = (-a * across).sum(-1) * inverse, turned @ direction * inverse
        distance = (c * turned).sum(-1) * inverse
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (distance > 0)
    return float(distance[hit].min(initial=np.inf))


def _dimmed(part: Part, factor: float) -> Part:
    material = part.material.copy()
    material[:, EMISSION] *= factor
    return replace(part, material=material)
