"""Render scene files: pictures from their cameras, or films.

    python launch/render.py scene=data/scenes/cornell_box.json
    python launch/render.py scene=chair.glb checkpoint=data/runs/quickstart/latest/checkpoints/best.ckpt
    python launch/render.py scene=chair.glb motion=turntable tone_map=agx

Without a checkpoint, the included radiosity renders; with one of launch/train.py, that network.
"""

from __future__ import annotations

import rfpp.interrupts  # noqa: F401 (first: what follows takes seconds to import)

# isort: split
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from rfpp import Renderer
from rfpp.commands import CONFIG_DIR, entry_point, settings
from rfpp.errors import UserError
from rfpp.imaging.tone_maps import ToneMap
from rfpp.inference.animation import Film
from rfpp.inference.gbuffers import GBufferSource
from rfpp.inference.layers import bounce_layers, exr_layers, light_layers
from rfpp.inference.motion.frames import Frames, with_cameras
from rfpp.inference.overlapped_writing import written_beside
from rfpp.inference.references import path_traced
from rfpp.inference.request import Request
from rfpp.inference.stills import write_comparison, write_still
from rfpp.inference.video import encoder, write_video
from rfpp.metrics.flip import flip_library
from rfpp.progress import counting
from rfpp.reference.cycles import CyclesSettings, require_blender
from rfpp.scene.packed import PackedScene
from rfpp.training.config_file import write_config
from rfpp.training.tracking.registry import checkpoint_file


@entry_point("render", CONFIG_DIR / "render")
def main(cfg: DictConfig) -> list[Path]:
    """Render `cfg.scene` with `cfg.checkpoint`; returns an EXR file for each camera, or an MP4 file for each scene."""
    if missing := OmegaConf.missing_keys(cfg):
        key = max(missing)  # the scene before others
        raise UserError(f"{key} is not given: add {key}=… to the command line")
    request = Request.of(OmegaConf.to_container(cfg, resolve=True))
    tone_map = instantiate(cfg.tone_map, stops=request.exposure)
    motion, cycles = instantiate(cfg.get("motion")), cycles_settings(request, cfg.against)
    if motion and cfg.against:
        raise UserError(f"against={cfg.against}: stands beside stills, not in a film: leave it away")
    for parts in ("lights", "bounces"):
        if motion and getattr(request, parts) == "separate":
            raise UserError(f"{parts}=separate: layers are those of stills, a film has none: leave it away")
    if motion:
        scenes = [motion.frames_of(path, request.one_camera(), request.load) for path in request.scene]
        files = [request.film(path, motion.name) for path in request.scene]
        encoder()  # what is not installed is missed before anything is rendered
    else:
        scenes = [with_cameras(request.load(path), path, request.cameras) for path in request.scene]
        files = [request.stills(path, len(scene.fov)) for path, scene in zip(request.scene, scenes, strict=True)]

    renderer = load(cfg.checkpoint, cfg)
    beside = {str(cfg.against): load(cfg.against, cfg)} if cfg.against else {}
    size = renderer.image_size(request.resolution)
    studio = Studio(renderer, beside, size, request, tone_map, cycles, Console(highlight=False, soft_wrap=True))
    written: list[Path] = []
    for path, scene, file in zip(request.scene, scenes, files, strict=True):
        written += [studio.film(scene, file)] if motion else studio.stills(scene, file)
        write_config(cfg, written[-1].parent, f"{path.stem}.yaml")
    return written


@dataclass(frozen=True)
class Studio:
    """What the pictures of one command have in common.

    Attributes:
        renderer: of all files but comparisons.
        beside: name → another one, whose pictures stand in comparisons too.
        cycles: settings of the path tracer, if it renders too.
    """

    renderer: Renderer
    beside: Mapping[str, Renderer]
    size: tuple[int, int]
    request: Request
    tone_map: ToneMap
    cycles: CyclesSettings | None
    console: Console

    def stills(self, scene: PackedScene, files: Sequence[Path]) -> Sequence[Path]:
        """A picture from each camera."""
        layers, sampling = self.request.layers, self.request.sampling
        gbuffer = GBufferSource(layers).of(scene, *self.size, self.request.light_samples)

        def write(image, view: int) -> None:
            apart = light_layers({name: images[view] for name, images in lights.items()})
            apart |= bounce_layers([images[view] for images in bounces])
            write_still(image, files[view], self.tone_map, exr_layers(gbuffer(view), layers) | apart)

        begin, lights, bounces = time.perf_counter(), {}, ()
        if self.request.lights == "separate":
            lights = self.renderer.render_lights(scene, self.size, **sampling)
        if self.request.bounces == "separate":
            bounces = self.renderer.render_bounces(scene, self.size, **sampling)
        parts = [*lights.values()] or [*bounces]
        views = sum(parts) if parts else self.renderer.views(scene, self.size, **sampling)
        images = list(written_beside(views, range(len(files)), write))
        many = f"{len(files)} view{'s' * (len(files) > 1)} of {self.size[1]} x {self.size[0]}"
        self.console.print(f"{scene.name}: {many} in {time.perf_counter() - begin:.2f} s")
        notes = [""] * len(files)
        if self.cycles:
            with self.console.status(f"Path tracing {many} at {self.cycles.samples} samples …"):
                [(references, seconds)] = path_traced([scene], self.size, self.cycles)
            self.console.print(f"{scene.name}: reference of {self.cycles.samples} samples in {seconds:.2f} s")
            others = {who: other.render(scene, self.size, **sampling) for who, other in self.beside.items()}
            for view, (image, reference, file) in enumerate(zip(images, references, files, strict=True)):
                seen = {who: pictures[view] for who, pictures in others.items()}
                notes[view] = f": FLIP {write_comparison(image, reference, file, self.tone_map, seen):.3f}"
        for file, note in zip(files, notes, strict=True):
            self.console.print(f"  {file}, {file.with_suffix('.png').name}{note}")
        return files

    def film(self, frames: Frames, file: Path) -> Path:
        """A film, whose frames stay in a folder of its name: the same command goes on with those that are missing."""
        film, say = Film(frames, file.with_name(f"{file.stem}_frames"), self.size), self.console.print
        begin = time.perf_counter()
        with counting(self.console, "frames") as (show, _):
            made = film.render(self.renderer, self.request.sampling, show)
        took = f"{made} rendered in {time.perf_counter() - begin:.2f} s"
        say(f"{file.stem}: {len(frames)} frames of {self.size[1]} x {self.size[0]}, {took}")
        say(f"  {write_video(film.pictures(self.tone_map), file, self.request.fps)}, frames in {film.folder}")
        if self.cycles:
            begin = time.perf_counter()
            with counting(self.console, "references") as (show, _):
                made = film.path_trace(self.cycles, show)
            took = f"{made} path-traced at {self.cycles.samples} samples in {time.perf_counter() - begin:.2f} s"
            say(f"{file.stem}: {took}; flicker {film.flicker():.3f} of the reference's own change")
            beside = file.with_name(f"{file.stem}_comparison.mp4")
            say(f"  {write_video(film.comparison(self.tone_map), beside, self.request.fps)}")
        return file


def load(checkpoint: str, cfg: DictConfig) -> Renderer:
    """A checkpoint by whatever name `cfg` gives it."""
    file = checkpoint_file(str(checkpoint), cfg.registry.tracking_uri, Path(cfg.registry.folder))
    return Renderer.load(file, cfg.device, cfg.precision)


def cycles_settings(request: Request, against: str | None) -> CyclesSettings | None:
    """How references are path-traced, if any are wanted. Raises UserError: no such settings, or a missing program."""
    if not request.reference:
        if against:
            raise UserError(f"against={against}: stands in the comparison with a reference: add reference=true")
        return None
    chosen = settings("reference", "reference_settings", request.reference_settings)
    require_blender()
    flip_library()
    return instantiate(chosen)


if __name__ == "__main__":
    main()
