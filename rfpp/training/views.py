"""Training views of stored scenes, with augmentation: rigid, of colours, of lights."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice

import numpy as np
from scipy.spatial.transform import Rotation
from torch.utils.data import Dataset, Sampler

from rfpp.batch import SceneViews
from rfpp.errors import UserError
from rfpp.gbuffer.first_hit import CHANNELS, COLOUR_CHANNELS
from rfpp.scene.triangles import DIFFUSE, EMISSION, SPECULAR, SceneTriangles
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.joined import JoinedSplit
from rfpp.shards.mixing import mixed
from rfpp.shards.order import ShuffledOrder
from rfpp.shards.sample import SceneSample
from rfpp.shards.views import read_views
from rfpp.training.dealing import Dealing


@dataclass(frozen=True)
class RigidAugmentation:
    """Random rigid motion of scene and cameras; images and camera-space G-buffers do not change.

    RSPE makes the network indifferent to translations but not to rotations (RenderFormer trains so too).

    Args:
        rotation: standard deviation of each component of the rotation vector, radians.
        translation: standard deviation of each component of the translation, world units.
    """

    rotation: float
    translation: float

    def __call__(self, views: SceneViews, rng: np.random.Generator) -> SceneViews:
        turn = Rotation.from_rotvec(rng.normal(0, self.rotation, 3)).as_matrix()
        shift = rng.normal(0, self.translation, 3)
        return moved(views, turn, shift)


def moved(views: SceneViews, rotation: np.ndarray, translation: np.ndarray) -> SceneViews:
    """Scene and cameras after p → rotation · p + translation."""
    old, turn = views.triangles, rotation.T.astype(np.float32)
    triangles = SceneTriangles(
        positions=(old.positions.reshape(-1, 3) @ turn + translation.astype(np.float32)).reshape(-1, 3, 3),
        normals=(old.normals.reshape(-1, 3) @ turn).reshape(-1, 3, 3),
        material=old.material,
        object_offsets=old.object_offsets,
        object_names=old.object_names,
    )
    move = np.eye(4)
    move[:3, :3], move[:3, 3] = rotation, translation
    cells = None if views.cells is None else views.cells.moved(rotation, translation)
    return replace(views, triangles=triangles, c2w=(move @ views.c2w).astype(np.float32), cells=cells)


class ColourPermutation:
    """Random permutation of the colour channels of materials, lights and images.

    Not in the paper, whose data set is two thousand times quickstart's.
    """

    def __call__(self, views: SceneViews, channels: Sequence[str], rng: np.random.Generator) -> SceneViews:
        order = rng.permutation(3)
        material = views.triangles.material.copy()
        for colour in (DIFFUSE, SPECULAR, EMISSION):
            material[:, colour] = material[:, colour][:, order]
        gbuffer, start = views.gbuffer.copy(), 0
        for name in channels:
            if name in COLOUR_CHANNELS:
                gbuffer[:, start : start + 3] = gbuffer[:, start : start + 3][:, order]
            start += CHANNELS[name]
        triangles = replace(views.triangles, material=material)
        light = views.object_light[:, order]
        cells = None if views.cells is None else views.cells.recoloured(order)
        image = views.image[:, order]
        return replace(views, triangles=triangles, gbuffer=gbuffer, image=image, object_light=light, cells=cells)


@dataclass(frozen=True)
class LightMixing:
    """Gives every light of a stored scene another intensity and colour; references and known light follow exactly.

    For data sets that hold the light of each light apart (`data.by_light`). Not in the paper.

    Args:
        power: intensities are multiplied by 1 / power to power, uniformly in their logarithm.
        saturation: 0 leaves lights' colours as they are; else red, green and blue are multiplied each by a number
            between 1 - saturation and 1.

    Raises:
        UserError: a power below 1, or a saturation that is not between 0 and 1.
    """

    power: float | int
    saturation: float | int

    def __post_init__(self) -> None:
        if self.power < 1 or not 0 <= self.saturation < 1:
            raise UserError(
                f"light_augmentation: power={self.power}, saturation={self.saturation}: use a power of 1 or more and a "
                "saturation from 0 to below 1"
            )

    def __call__(self, sample: SceneSample, rng: np.random.Generator) -> SceneSample:
        """Raises ShardError for a sample whose lights are not stored apart."""
        lights = sample.triangles.num_lights
        power = self.power ** rng.uniform(-1, 1, (lights, 1))
        return mixed(sample, power * rng.uniform(1 - self.saturation, 1, (lights, 3)))


class TrainingViews(Dataset):
    """Random views of a split's scenes, a pure function of (seed, epoch, scene).

    Args:
        split: stored scenes.
        channels: G-buffer channels.
        views_per_scene: views drawn without replacement from each scene's.
        rigid, colour: augmentations applied to each draw, or None.
        seed: of the draws.
        lights: the same, of lights.
    """

    def __init__(
        self,
        split: ShardSplit | JoinedSplit,
        channels: Sequence[str],
        views_per_scene: int,
        rigid: RigidAugmentation | None,
        colour: ColourPermutation | None,
        seed: int,
        lights: LightMixing | None = None,
    ):
        self.split, self.channels = split, tuple(channels)
        self.views_per_scene, self.rigid, self.colour, self.seed = views_per_scene, rigid, colour, seed
        self.lights = lights

    def __getitem__(self, draw: tuple[int, int]) -> SceneViews:
        epoch, index = draw
        rng = np.random.default_rng(np.random.SeedSequence([self.seed, epoch, index]))
        chosen = read_views(
            self.split,
            index,
            self.channels,
            lambda views: rng.permutation(views)[: self.views_per_scene].tolist(),
            self.lights and partial(self.lights, rng=rng),
        )
        if self.rigid:
            chosen = self.rigid(chosen, rng)
        if self.colour:
            chosen = self.colour(chosen, self.channels, rng)
        return chosen


class GlobalBatches(Sampler[list[tuple[int, int]]]):
    """One rank's share of each global batch, for a whole run: lists of (epoch, scene index).

    The global order runs through epoch after epoch and is the same for any number of ranks. Each global batch is dealt
    to the ranks, and what a rank has got to `accumulate` smaller batches one after the other.

    Args:
        order: of the scenes.
        dealing: who gets what.
        triangles_of: the scene of a draw has so many.
        scenes_per_batch: global, over all ranks.
        batches: global ones in the whole run.
        start: how many of them were trained on before.
        rank, ranks: which part to take.
        accumulate: in how many batches to give the part.
    """

    def __init__(
        self,
        order: ShuffledOrder,
        dealing: Dealing,
        triangles_of: Callable[[tuple[int, int]], int],
        scenes_per_batch: int,
        batches: int,
        start: int = 0,
        rank: int = 0,
        ranks: int = 1,
        accumulate: int = 1,
    ):
        if scenes_per_batch % (ranks * accumulate):
            raise ValueError(
                f"{scenes_per_batch} scenes per step do not divide among {ranks} ranks, {accumulate} batches each"
            )
        self.order, self.dealing, self.triangles_of = order, dealing, triangles_of
        self.scenes_per_batch = scenes_per_batch
        self.batches, self.start = batches, start
        self.rank, self.ranks, self.accumulate = rank, ranks, accumulate

    def __len__(self) -> int:
        """Batches of this rank in the whole run; Lightning counts on from `start` itself."""
        return self.batches * self.accumulate

    def __iter__(self) -> Iterator[list[tuple[int, int]]]:
        draws = self.order.draws(self.start * self.scenes_per_batch)
        for _ in range(self.start, self.batches):
            batch = list(islice(draws, self.scenes_per_batch))
            share = self.dealing(batch, self.triangles_of, self.ranks)[self.rank]
            yield from self.dealing(share, self.triangles_of, self.accumulate)
