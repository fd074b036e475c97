"""Render a scene file with a trained network.

    python launch/render.py scene=data/scenes/cornell_box.json \\
        checkpoint=data/runs/quickstart/latest/checkpoints/best.ckpt
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from rfpp import Renderer, Scene
from rfpp.entry import CONFIG_DIR, entry_point, required
from rfpp.errors import UserError
from rfpp.exr import write_exr
from rfpp.panels import error_map, panel, save_png, tone_mapped
from rfpp.reference.cycles import CyclesSettings
from rfpp.reference.cycles import render as path_trace
from rfpp.reference.farm import RenderFarm
from rfpp.scene.packed import PackedScene, pack
from rfpp.training.run import write_config
from rfpp.training.tracking.registry import checkpoint_file


@entry_point("render", CONFIG_DIR / "render")
def main(cfg: DictConfig) -> list[Path]:
    """Render `cfg.scene` with `cfg.checkpoint`; returns the EXR files, one for each camera."""
    console = Console(highlight=False, soft_wrap=True)
    scene = with_cameras(pack(Scene.load(required(cfg, "scene"))), cfg.cameras)
    checkpoint = checkpoint_file(required(cfg, "checkpoint"), cfg.registry.tracking_uri, Path(cfg.registry.folder))
    renderer = Renderer.load(checkpoint, cfg.device, cfg.precision)
    resolution = OmegaConf.to_object(cfg.resolution) if OmegaConf.is_list(cfg.resolution) else cfg.resolution
    height, width = renderer.image_size(tuple(resolution) if isinstance(resolution, list) else resolution)

    begin = time.perf_counter()
    targets = output_files(Path(cfg.output), Path(cfg.scene).stem, len(scene.fov))
    images = written_beside(renderer.views(scene, (height, width)), targets)
    console.print(f"{scene.name}: {len(images)} views of {width} x {height} in {time.perf_counter() - begin:.2f} s")
    if cfg.reference:
        settings = OmegaConf.load(CONFIG_DIR / "reference" / f"{cfg.reference_settings}.yaml")
        references = reference_images(scene, height, width, instantiate(settings), console)
        for image, reference, target in zip(images, references, targets, strict=True):
            write_pictures(reference, target.with_name(f"{target.stem}_reference.exr"))
            columns = {
                "path-traced reference": [tone_mapped(reference)],
                "prediction": [tone_mapped(image)],
                "error": [error_map(image, reference)],
            }
            save_png(panel(columns), target.with_name(f"{target.stem}_comparison.png"))
    write_config(cfg, targets[0].parent, f"{Path(cfg.scene).stem}.yaml")
    console.print("\n".join(f"  {target}, {target.with_suffix('.png').name}" for target in targets))
    return targets


def with_cameras(scene: PackedScene, wanted: list[int] | None) -> PackedScene:
    """The scene with only the wanted cameras. Raises UserError when one does not exist."""
    if wanted is None:
        return scene
    if not wanted or min(wanted) < 0 or max(wanted) >= len(scene.fov):
        raise UserError(f"cameras={list(wanted)}: the scene has cameras 0…{len(scene.fov) - 1}: choose among them")
    return scene.views(wanted)


def output_files(output: Path, stem: str, views: int) -> list[Path]:
    """One EXR path for each view: `output` itself where it names the file of a single view, else numbered."""
    if output.suffix == ".exr":
        if views == 1:
            return [output]
        output, stem = output.parent, output.stem
    return [output / f"{stem}_{view}.exr" for view in range(views)]


def written_beside(images: Iterable[np.ndarray], targets: Sequence[Path]) -> list[np.ndarray]:
    """The images, each written by a thread while the next one is rendered."""
    kept: list[np.ndarray] = []
    with ThreadPoolExecutor(1, "writing") as beside:
        writing = None
        for image, target in zip(images, targets, strict=True):
            if writing:
                writing.result()  # raises what went wrong: nothing more is rendered for a full disk
            writing = beside.submit(write_pictures, image, target)
            kept.append(image)
        writing.result()
    return kept


def write_pictures(radiance: np.ndarray, target: Path) -> None:
    """Linear radiance as half-float EXR, and tone-mapped as PNG beside it."""
    write_exr(target, {"RGB": np.ascontiguousarray(radiance.astype(np.float16))})
    save_png(tone_mapped(radiance), target.with_suffix(".png"))


def reference_images(
    scene: PackedScene, height: int, width: int, settings: CyclesSettings, console: Console
) -> np.ndarray:
    """The same views path-traced by Blender Cycles, in a worker process of its own."""
    job = partial(path_trace, c2w=scene.c2w, fov=scene.fov, height=height, width=width, settings=settings)
    begin = time.perf_counter()
    with console.status(f"Path tracing {len(scene.fov)} views at {settings.samples} samples …"), RenderFarm(1) as farm:
        [(_, images)] = farm.map(job, [scene.triangles])
    if isinstance(images, Exception):
        raise images
    console.print(f"{scene.name}: reference of {settings.samples} samples in {time.perf_counter() - begin:.1f} s")
    return images


if __name__ == "__main__":
    main()
