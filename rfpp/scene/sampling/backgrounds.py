"""Random backgrounds: a floor and up to three walls."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rfpp.errors import SceneError
from rfpp.scene.mesh import Mesh
from rfpp.scene.sampling.interval import HasIntervals, Interval, uniform
from rfpp.scene.sampling.open_region import OpenRegion
from rfpp.scene.spec import Transform, rotation_matrix

#: Inward normal of each panel, which stands half a unit from the center on the opposite side.
PANELS = {"floor": (0, 0, 1), "back": (0, -1, 0), "right": (-1, 0, 0), "left": (1, 0, 0)}

#: Panels of the four kinds of background. Cameras look from -y (and -x).
KINDS = {
    "plane": ("floor",),
    "wall": ("floor", "back"),
    "corner": ("floor", "back", "right"),
    "box": ("floor", "back", "right", "left"),
}

#: Squares along each side of a panel: 8 · 8 · 2 = 128 triangles, as in RenderFormer.
_SQUARES = 8


@dataclass(frozen=True, eq=False)
class Background:
    """The panels of a background, without materials.

    Attributes:
        open_region: the region in front of all panels.
    """

    kind: str
    meshes: tuple[Mesh, ...]
    transforms: tuple[Transform, ...]
    open_region: OpenRegion


@dataclass(frozen=True)
class PanelJitter(HasIntervals):
    """Random displacement of a panel, in world units (RenderFormer's numbers, halved).

    Attributes:
        half_extent: half extents of the panel along its sides.
        slide: displacement along these sides.
        floor_lift: upward displacement of the floor from z = -0.5, which keeps a tilted floor inside the cube.
        wall_offset: inward displacement of a wall along its normal.
        tilt: degrees of rotation about each axis.
    """

    half_extent: Interval
    slide: Interval
    floor_lift: Interval
    wall_offset: Interval
    tilt: Interval

    def sample(self, rng: np.random.Generator, panel: str) -> Transform:
        """Draw the transform of a panel; its mesh is the unit grid of `panel_mesh`."""
        normal = np.array(PANELS[panel], dtype=float)
        across = np.abs(normal) > 0
        offset = uniform(rng, self.floor_lift if panel == "floor" else self.wall_offset)
        translation = np.where(across, normal * (offset - 0.5), uniform(rng, self.slide, 3))
        return Transform(
            translation=tuple(translation.tolist()),
            rotation=tuple(uniform(rng, self.tilt, 3).tolist()),
            scale=tuple(np.where(across, 0.5, uniform(rng, self.half_extent, 3)).tolist()),
            normalize=False,
        )


@dataclass(frozen=True)
class BackgroundSampler:
    """One of the four kinds of background, with independently displaced panels.

    Attributes:
        box_jitter: displacement of a box's panels, small enough to keep it closed.
    """

    weights: Mapping[str, float | int]
    jitter: PanelJitter
    box_jitter: PanelJitter

    def __post_init__(self) -> None:
        for kind in self.weights:
            if kind not in KINDS:
                raise SceneError(f"BackgroundSampler.weights: unknown kind '{kind}': choose from {', '.join(KINDS)}")
        if not self.weights or min(self.weights.values()) < 0 or sum(self.weights.values()) <= 0:
            raise SceneError("BackgroundSampler.weights: give at least one positive weight and no negative one")

    def sample(self, rng: np.random.Generator) -> Background:
        """Draw a background whose open side contains the scene's center."""
        weights = np.array(list(self.weights.values()), dtype=float)
        kind = list(self.weights)[rng.choice(len(weights), p=weights / weights.sum())]
        jitter = self.box_jitter if kind == "box" else self.jitter
        transforms = tuple(jitter.sample(rng, panel) for panel in KINDS[kind])
        return Background(
            kind=kind,
            meshes=tuple(panel_mesh(panel) for panel in KINDS[kind]),
            transforms=transforms,
            open_region=_open_region(KINDS[kind], transforms),
        )


def panel_mesh(panel: str) -> Mesh:
    """Return the square [-1, 1]² of 128 triangles through the origin, facing along the panel's normal."""
    normal = np.array(PANELS[panel], dtype=float)
    first = np.roll(np.abs(normal), 1)
    second = np.cross(normal, first)  # first × second = normal: counter-clockwise seen from inside
    ticks = np.linspace(-1, 1, _SQUARES + 1)
    vertices = ticks[:, None, None] * first + ticks[None, :, None] * second
    index = np.arange((_SQUARES + 1) ** 2).reshape(_SQUARES + 1, _SQUARES + 1)
    quads = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1).reshape(-1, 4)
    return Mesh(vertices.reshape(-1, 3), quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3))


def _open_region(panels: tuple[str, ...], transforms: tuple[Transform, ...]) -> OpenRegion:
    # a transform rotates, then scales: normals take the inverse scale
    normals = np.stack(
        [rotation_matrix(t.rotation) @ PANELS[p] / np.array(t.scale) for p, t in zip(panels, transforms, strict=True)]
    )
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return OpenRegion(normals, np.einsum("pi,pi->p", normals, np.array([t.translation for t in transforms])))
