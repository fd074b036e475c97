"""What the time buys: a trained network beside Cycles with few samples and its denoiser, which is what users have."""

from __future__ import annotations

import io
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import blake2b
from pathlib import Path
from statistics import median

import numpy as np
import torch
from jaxtyping import Float

from rfpp.benchmark.exhibits import SampledScene, SceneFile
from rfpp.files import write_atomically
from rfpp.inference.references import Traced, path_traced
from rfpp.inference.renderer import Renderer
from rfpp.metrics.flicker import flicker
from rfpp.metrics.flip import flip
from rfpp.metrics.image import log_l1, ssim
from rfpp.reference.cycles import CyclesSettings
from rfpp.scene.packed import PackedScene
from rfpp.scene.triangles import EMISSION

Row = dict[str, str | int | float]
Image = Float[np.ndarray, "h w 3"]
#: Degrees about the vertical axis from a view to the next one, and from the first frame of a film to the last.
_NEXT_VIEW, _ARC = 5.0, 12.0
_NETWORK = "rfpp"


@dataclass(frozen=True)
class FilmSettings:
    """Attributes:
    frames: on an arc about the scene.
    resolution: pixels.
    samples: of its reference.
    """

    frames: int
    resolution: int
    samples: int


@dataclass(frozen=True)
class Taken:
    """What one method makes of one scene.

    Attributes:
        first: picture of a scene that it has not seen before.
        seconds: of the first picture, of the next view, and after one light was dimmed.
    """

    first: Image
    seconds: tuple[float, float, float]


def measure(
    checkpoint: str,
    exhibits: Sequence[SceneFile | SampledScene],
    resolution: int,
    samplings: Sequence[Mapping[str, int]],
    samples: Sequence[int],
    rounds: int,
    cycles: CyclesSettings,
    converged: CyclesSettings,
    film: FilmSettings | None,
    kept: Path | str,
    progress: Callable[[int, int], None],
) -> Iterator[Row]:
    """A row per scene and method: seconds, errors of the first picture, flicker of a film.

    All are warm, and take turns; seconds are medians over the rounds.

    Args:
        checkpoint: see `rfpp.checkpoint.loading.load_network`.
        samplings: of the network's methods: `light_samples`, `supersampling` and `token_resolution` of
            `Renderer.render`.
        samples: of Cycles' methods.
        rounds: how often all are timed.
        cycles: its settings but for the samples.
        converged: those of the references.
        film: None leaves films out.
        kept: folder of references, which are rendered once.
        progress: called with (turns taken, turns in all).
    """
    renderer, scenes = Renderer.load(checkpoint), [exhibit.scene() for exhibit in exhibits]
    truths = [_reference(scene, resolution, converged, Path(kept))[0] for scene in scenes]
    methods: dict[str, Method] = {_named(sampling): ByNetwork(renderer, sampling) for sampling in samplings}
    methods |= {f"Cycles {count}": ByCycles(replace(cycles, samples=count)) for count in samples}
    taken: dict[str, list[list[Taken]]] = {name: [] for name in methods}
    turns = (rounds + 1) * len(methods)
    for turn in range(rounds):
        for number, (name, method) in enumerate(methods.items()):
            taken[name].append(method.pictures(scenes, resolution))
            progress(turn * len(methods) + number + 1, turns)
    arcs = [orbit(scene, np.linspace(0, _ARC, film.frames)) for scene in scenes] if film else []
    true_films = [
        _reference(arc, film.resolution, replace(converged, samples=film.samples), Path(kept)) for arc in arcs
    ]
    for number, (name, method) in enumerate(methods.items()):
        films = method.films(arcs, film.resolution) if film else []
        for place, (exhibit, truth) in enumerate(zip(exhibits, truths, strict=True)):
            of_scene = [turn[place] for turn in taken[name]]
            first, view, edit = (median(times) for times in zip(*(one.seconds for one in of_scene), strict=True))
            yield {
                "scene": exhibit.title,
                "method": name,
                **method.samples,
                "resolution": resolution,
                "first_s": first,
                "view_s": view,
                "edit_s": edit,
                **errors(of_scene[0].first, truth),
                **(_of_film(*films[place], true_films[place]) if film else {}),
            }
        progress(rounds * len(methods) + number + 1, turns)


def _named(sampling: Mapping[str, int]) -> str:
    return f"{_NETWORK} {sampling['light_samples']} of {sampling['supersampling'] ** 2}"


def _of_film(frames: Float[np.ndarray, "v h w 3"], seconds: float, truth: Float[np.ndarray, "v h w 3"]) -> Row:
    """Seconds of a frame, and flicker."""
    return {"frame_s": seconds / len(frames), "flicker": flicker(frames, truth)}


def errors(image: Image, truth: Image) -> Row:
    """log-L1, ꟻLIP and SSIM of linear radiance."""
    x, y = (torch.from_numpy(np.ascontiguousarray(one)).permute(2, 0, 1)[None] for one in (image, truth))
    return {"log_l1": float(log_l1(x, y)), "flip": float(flip(image, truth).mean()), "ssim": float(ssim(x, y))}


def orbit(scene: PackedScene, degrees: Sequence[float] | np.ndarray) -> PackedScene:
    """Seen by its first camera, turned about the vertical axis through the origin by each of these angles."""
    turned = []
    for angle in np.radians(degrees):
        turn = np.eye(4)
        turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        turned.append(turn @ scene.c2w[0])
    return replace(scene, c2w=np.stack(turned).astype(np.float32), fov=np.repeat(scene.fov[:1], len(turned)))


def dimmed(scene: PackedScene) -> PackedScene:
    """The scene with half the light of its first emitting object."""
    triangles = scene.triangles
    material, lamp = triangles.material.copy(), triangles.object_index[triangles.is_emissive][0]
    material[triangles.object_index == lamp, EMISSION] *= 0.5
    return replace(scene, triangles=replace(triangles, material=material))


def _situations(scene: PackedScene) -> tuple[PackedScene, PackedScene, PackedScene]:
    """New, from another side, edited."""
    return scene, orbit(scene, [_NEXT_VIEW]), dimmed(scene)


class Method(ABC):
    """A way to make pictures of scenes, and the films of arcs."""

    @property
    @abstractmethod
    def samples(self) -> dict[str, int]:
        """Columns of the table: how many, of which kind."""

    @abstractmethod
    def pictures(self, scenes: Sequence[PackedScene], resolution: int) -> list[Taken]:
        """Of every scene: its first picture, and the seconds of that, of the next view, and of an edit."""

    @abstractmethod
    def films(self, arcs: Sequence[PackedScene], resolution: int) -> list[Traced]:
        """Of every arc: its frames, and their seconds together."""


@dataclass(frozen=True)
class ByNetwork(Method):
    """Attributes:
    renderer: of the network; every scene gets one that has seen nothing yet.
    sampling: see `measure`.
    """

    renderer: Renderer
    sampling: Mapping[str, int]

    @property
    def samples(self) -> dict[str, int]:
        return {**self.sampling, "samples": 0}

    def pictures(self, scenes: Sequence[PackedScene], resolution: int) -> list[Taken]:
        self.renderer.render(scenes[-1], resolution, **self.sampling)  # wakes it up
        taken = []
        for scene in scenes:
            fresh, images, seconds = self._fresh(), [], []
            for situation in _situations(scene):
                begin = time.perf_counter()
                images.append(fresh.render(situation, resolution, **self.sampling)[0])
                seconds.append(time.perf_counter() - begin)
            taken.append(Taken(images[0], tuple(seconds)))
        return taken

    def films(self, arcs: Sequence[PackedScene], resolution: int) -> list[Traced]:
        films = []
        for arc in arcs:
            fresh, begin = self._fresh(), time.perf_counter()
            films.append((fresh.render(arc, resolution, **self.sampling), time.perf_counter() - begin))
        return films

    def _fresh(self) -> Renderer:
        return Renderer(self.renderer.network, self.renderer.info, self.renderer.device, self.renderer.dtype)


@dataclass(frozen=True)
class ByCycles(Method):
    """Attributes:
    settings: of the path tracer.
    """

    settings: CyclesSettings

    @property
    def samples(self) -> dict[str, int]:
        of_network = dict.fromkeys(("light_samples", "supersampling", "token_resolution"), 0)
        return {**of_network, "samples": self.settings.samples}

    def pictures(self, scenes: Sequence[PackedScene], resolution: int) -> list[Taken]:
        asked = [scenes[-1], *(situation for scene in scenes for situation in _situations(scene))]
        [_, *traced] = path_traced(asked, (resolution, resolution), self.settings)  # the first wakes it up
        by_scene = [traced[i : i + 3] for i in range(0, len(traced), 3)]
        return [Taken(of_scene[0][0][0], tuple(seconds for _, seconds in of_scene)) for of_scene in by_scene]

    def films(self, arcs: Sequence[PackedScene], resolution: int) -> list[Traced]:
        [_, *traced] = path_traced([arcs[-1].views([0]), *arcs], (resolution, resolution), self.settings)
        return traced


def _reference(
    scene: PackedScene, resolution: int, settings: CyclesSettings, folder: Path
) -> Float[np.ndarray, "v h w 3"]:
    """From the folder, or rendered into it."""
    digest = blake2b(f"{settings} {resolution}".encode(), digest_size=16)
    for array in (scene.triangles.positions, scene.triangles.normals, scene.triangles.material, scene.c2w, scene.fov):
        digest.update(np.ascontiguousarray(array))
    file = folder / f"{digest.hexdigest()}.npy"
    if not file.exists():
        [(images, _)] = path_traced([scene], (resolution, resolution), settings)
        stream = io.BytesIO()
        np.save(stream, images)
        write_atomically(file, stream.getvalue())
    return np.load(file, allow_pickle=False)
