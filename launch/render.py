"""Render scene files: pictures from their cameras, or animations.

    python launch/render.py scene=data/scenes/cornell_box.json
    python launch/render.py scene=chair.glb checkpoint=data/runs/quickstart/latest/checkpoints/best.ckpt
    python launch/render.py scene=chair.glb motion=turntable tone_map=agx

The default model is the included radiosity; a checkpoint of launch/train.py selects a trained network.
"""

from __future__ import annotations

import rfpp.interrupts  # noqa: F401 (first, because the imports below take seconds)

# isort: split
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from rfpp import Renderer
from rfpp.commands import CONFIG_DIR, entry_point, settings, write_config
from rfpp.errors import UserError
from rfpp.imaging.tone_maps import ToneMap, tone_map_of
from rfpp.inference.animation import Animation
from rfpp.inference.gbuffers import GBufferSource
from rfpp.inference.motion.frames import Frames, with_cameras
from rfpp.inference.references import path_traced
from rfpp.inference.render_settings import RenderSettings
from rfpp.inference.stills import (
    bounce_layers,
    darkness,
    gbuffer_layers,
    light_layers,
    write_comparison,
    write_still,
    written_in_background,
)
from rfpp.inference.video import require_encoder, write_video
from rfpp.metrics.flip import flip_library
from rfpp.progress import counting
from rfpp.raycast.compiled import announce_compilation
from rfpp.reference.cycles import CyclesSettings, require_blender
from rfpp.scene.packed import PackedScene
from rfpp.training.tracking.registry import checkpoint_file


@entry_point("render", CONFIG_DIR / "render")
def main(cfg: DictConfig) -> list[Path]:
    """Render `cfg.scene` with `cfg.checkpoint`; return an EXR file per camera, or an MP4 file per scene."""
    if missing := OmegaConf.missing_keys(cfg):
        key = max(missing)  # the scene before others
        raise UserError(f"{key} is missing: add {key}=… to the command line")
    chosen = RenderSettings.parse(OmegaConf.to_container(cfg, resolve=True))
    tone_map = tone_map_of(cfg.tone_map, chosen.exposure)
    motion, cycles = instantiate(cfg.get("motion")), cycles_settings(chosen, cfg.against)
    if motion:
        if cfg.against:
            raise UserError(f"against={cfg.against}: applies to stills, not to animations: omit it")
        for parts in ("lights", "bounces"):
            if getattr(chosen, parts) == "separate":
                raise UserError(f"{parts}=separate: applies to stills, not to animations: omit it")
        scenes = [motion.frames_of(path, chosen.single_camera(), chosen.load) for path in chosen.scene]
        files = [chosen.video(path, motion.name) for path in chosen.scene]
        require_encoder()  # before rendering
    else:
        scenes = [with_cameras(chosen.load(path), path, chosen.cameras) for path in chosen.scene]
        files = [chosen.stills(path, len(scene.fov)) for path, scene in zip(chosen.scene, scenes, strict=True)]

    renderer = load(cfg.checkpoint, cfg)
    others = {str(cfg.against): load(cfg.against, cfg)} if cfg.against else {}
    size = renderer.image_size(chosen.resolution)
    command = Command(renderer, others, size, chosen, tone_map, cycles, Console(highlight=False, soft_wrap=True))
    announce_compilation(command.console.print)
    written: list[Path] = []
    for path, scene, file in zip(chosen.scene, scenes, files, strict=True):
        written += [command.animation(scene, file)] if motion else command.stills(scene, file)
        write_config(cfg, written[-1].parent, f"{path.stem}.yaml")
    return written


@dataclass(frozen=True)
class Command:
    """Settings shared by all pictures of a command.

    Attributes:
        renderer: Renderer of the pictures.
        others: Name → another renderer, for comparisons.
        size: (height, width) in pixels.
        settings: Settings of the command line.
        tone_map: Tone map of PNG and MP4 files.
        cycles: Settings of the path tracer; None for no references.
        console: Console of the progress.
    """

    renderer: Renderer
    others: Mapping[str, Renderer]
    size: tuple[int, int]
    settings: RenderSettings
    tone_map: ToneMap
    cycles: CyclesSettings | None
    console: Console

    def stills(self, scene: PackedScene, files: Sequence[Path]) -> Sequence[Path]:
        """Render a picture per camera, and return the files."""
        names, sampling = self.settings.layers, self.settings.sampling
        gbuffer = GBufferSource(names).of(scene, *self.size, self.settings.light_samples)

        def write(image: np.ndarray, view: int) -> None:
            parts = light_layers({name: images[view] for name, images in lights.items()})
            parts |= bounce_layers([images[view] for images in bounces])
            write_still(image, files[view], self.tone_map, gbuffer_layers(gbuffer(view), names) | parts)

        begin, lights, bounces = time.perf_counter(), {}, ()
        if self.settings.lights == "separate":
            lights = self.renderer.render_lights(scene, self.size, **sampling)
        if self.settings.bounces == "separate":
            bounces = self.renderer.render_bounces(scene, self.size, **sampling)
        parts = [*lights.values()] or [*bounces]
        views = sum(parts) if parts else self.renderer.views(scene, self.size, **sampling)
        images = list(written_in_background(views, range(len(files)), write))
        count = f"{len(files)} view{'s' * (len(files) > 1)} of {self.size[1]} x {self.size[0]}"
        self.console.print(f"{scene.name}: {count} in {time.perf_counter() - begin:.2f} s")
        notes = self._compare(scene, images, files, count) if self.cycles else [""] * len(files)
        for file, note, image in zip(files, notes, images, strict=True):
            self.console.print(f"  {file}, {file.with_suffix('.png').name}{note}")
            if advice := darkness(image, self.tone_map):
                warnings.warn(f"{file.with_suffix('.png')}: {advice}", stacklevel=2)
        return files

    def _compare(self, scene: PackedScene, images: Sequence, files: Sequence[Path], count: str) -> list[str]:
        """Path-trace references and write comparisons; return a note per view."""
        with self.console.status(f"Path tracing {count} at {self.cycles.samples} samples …"):
            [(references, seconds)] = path_traced([scene], self.size, self.cycles)
        self.console.print(f"{scene.name}: reference of {self.cycles.samples} samples in {seconds:.2f} s")
        others = {name: other.render(scene, self.size, **self.settings.sampling) for name, other in self.others.items()}
        notes = []
        for view, (image, reference, file) in enumerate(zip(images, references, files, strict=True)):
            beside = {name: pictures[view] for name, pictures in others.items()}
            notes.append(f": FLIP {write_comparison(image, reference, file, self.tone_map, beside):.3f}")
        return notes

    def animation(self, frames: Frames, file: Path) -> Path:
        """Render an animation, and return its file. Its frames remain in a folder, from which it is resumed."""
        animation = Animation(frames, file.with_name(f"{file.stem}_frames"), self.size)
        begin, fps = time.perf_counter(), self.settings.fps
        with counting(self.console, "frames") as (show, _):
            count = animation.render(self.renderer, self.settings.sampling, show)
        took = f"{count} rendered in {time.perf_counter() - begin:.2f} s"
        self.console.print(f"{file.stem}: {len(frames)} frames of {self.size[1]} x {self.size[0]}, {took}")
        write_video(animation.pictures(self.tone_map), file, fps)
        self.console.print(f"  {file}, frames in {animation.folder}")
        if self.cycles:
            begin = time.perf_counter()
            with counting(self.console, "references") as (show, _):
                count = animation.path_trace(self.cycles, show)
            took = f"{count} path-traced at {self.cycles.samples} samples in {time.perf_counter() - begin:.2f} s"
            self.console.print(f"{file.stem}: {took}; flicker {animation.flicker():.3f} of the reference's own change")
            comparison = file.with_name(f"{file.stem}_comparison.mp4")
            self.console.print(f"  {write_video(animation.comparison(self.tone_map), comparison, fps)}")
        return file


def load(checkpoint: str | None, cfg: DictConfig) -> Renderer:
    """Load a checkpoint by its name on the command line."""
    file = checkpoint_file(checkpoint, cfg.registry.tracking_uri, Path(cfg.registry.folder))
    return Renderer.load(file, cfg.device, cfg.precision)


def cycles_settings(chosen: RenderSettings, against: str | None) -> CyclesSettings | None:
    """Return the settings of references, if requested. Raises UserError for an unknown preset or missing program."""
    if not chosen.reference:
        if against:
            raise UserError(f"against={against}: needs a reference to compare with: add reference=true")
        return None
    preset = settings("reference", "reference_settings", chosen.reference_settings, without=["radiosity"])
    require_blender()
    flip_library()
    return instantiate(preset)


if __name__ == "__main__":
    main()
