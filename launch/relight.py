"""Find the power and color of a scene's lights from a picture.

    python launch/relight.py scene=data/scenes/roughness_spheres.json target=evening.exr
    python launch/relight.py scene=room.glb target=[a.png,b.png] cameras=[0,2] colors=false

Writes the scene with these lights, its images, and a sheet of before, target and after.
"""

from __future__ import annotations

import rfpp.interrupts  # noqa: F401 (first, because the imports below take seconds)

# isort: split
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.table import Table

from rfpp import Renderer
from rfpp.commands import CONFIG_DIR, entry_point, required
from rfpp.errors import UserError
from rfpp.files import as_file_name
from rfpp.imaging.decoding import read_radiance
from rfpp.imaging.panels import error_map, panel, save_picture
from rfpp.imaging.tone_maps import ToneMap, tone_map_of
from rfpp.inference.motion.frames import with_cameras
from rfpp.inference.relight_settings import RelightSettings
from rfpp.inference.relighting import Images, SolvedLights, solve_lights, with_factors
from rfpp.inference.stills import write_still
from rfpp.raycast.compiled import announce_compilation
from rfpp.scene.io.saving import fits_json, save_scene
from rfpp.scene.spec import Scene
from rfpp.training.tracking.registry import checkpoint_file


@entry_point("relight", CONFIG_DIR / "render")
def main(cfg: DictConfig) -> Path:
    """Solve for the lights of `cfg.scene`, and return the scene file with them."""
    console = Console(highlight=False, soft_wrap=True)
    for name in ("scene", "target"):
        required(cfg, name)
    chosen = RelightSettings.parse(OmegaConf.to_container(cfg, resolve=True))
    path, tone_map = chosen.scene, tone_map_of(cfg.tone_map, chosen.exposure)
    scene = chosen.load(path)
    if not isinstance(scene, Scene):
        raise UserError(f"{path}: holds triangles but no objects: use a format other than H5")
    cameras = range(len(chosen.target)) if chosen.cameras is None else chosen.cameras
    views = with_cameras(scene, path, cameras)
    if not views.triangles.num_lights:
        raise UserError(f"{path}: has no lights to solve for: add one")
    target, is_valid = _read_targets(chosen.target, chosen.mask or (), chosen.exposure)

    file = checkpoint_file(cfg.checkpoint, cfg.registry.tracking_uri, Path(cfg.registry.folder))
    renderer = Renderer.load(file, chosen.device, cfg.precision)
    announce_compilation(console.print)
    with console.status(f"Rendering {views.triangles.num_lights} lights separately …"):
        layers = renderer.render_lights(views, target.shape[1:3], **chosen.sampling)
    solved = solve_lights(layers, target, is_valid, chosen.colors)

    table = Table("light", "red ×", "green ×", "blue ×")
    for name, factor in solved.factors.items():
        table.add_row(name, *(f"{value:.3f}" for value in factor))
    console.print(table)
    for name in solved.invisible:
        console.print(f"warning: '{name}' is invisible in the target: it keeps its values")
    for one, other in solved.alike:
        console.print(f"warning: '{one}' and '{other}' have the same effect on the target: only their sum is known")
    stem, folder = as_file_name(path.stem), chosen.output
    for view, image in enumerate(solved.images):
        write_still(image, folder / f"{stem}_relit_{view}.exr", tone_map)
    sheet = save_picture(_sheet(sum(layers.values()), target, solved, tone_map), folder / f"{stem}_relit.png")
    relit = with_factors(scene, solved.factors)
    written = save_scene(relit, folder / f"{stem}_relit.{'json' if fits_json(relit) else 'h5'}")
    console.print(f"Difference from the target: {solved.before:.1%} before, {solved.after:.1%} with these lights")
    console.print(f"  {written}, {sheet}, images of {len(target)} view{'s' * (len(target) > 1)} beside it")
    return written


def _read_targets(files: Sequence[Path], masks: Sequence[Path], stops: float) -> tuple[Images, np.ndarray]:
    """Return radiance and valid pixels. Raises UserError if sizes differ, or no pixel is valid."""
    pictures, valid = zip(*(read_radiance(file, stops) for file in files), strict=True)
    if len({picture.shape for picture in pictures}) > 1:
        raise UserError(f"target: {', '.join(map(str, files))} differ in size: give pictures of one size")
    is_valid = np.stack(valid)
    if masks:
        white = [read_radiance(mask)[0].mean(-1) > 0.2 for mask in masks]  # half of the 8-bit range
        if any(mask.shape != is_valid.shape[1:] for mask in white):
            raise UserError("mask: differs in size from its target")
        is_valid &= np.stack(white)
    if not is_valid.any():
        raise UserError(
            f"target: {', '.join(map(str, files))}: all pixels are clipped or masked: give another picture or mask"
        )
    return np.stack(pictures), is_valid


def _sheet(before: Images, target: Images, solved: SolvedLights, tone_map: ToneMap) -> np.ndarray:
    columns: dict[str, list[np.ndarray]] = {
        "before": [tone_map(image) for image in before],
        "target": [tone_map(image) for image in target],
        "after": [tone_map(image) for image in solved.images],
        "difference before": [error_map(*pair) for pair in zip(before, target, strict=True)],
        "difference after": [error_map(*pair) for pair in zip(solved.images, target, strict=True)],
    }
    return panel(columns)


if __name__ == "__main__":
    main()
