"""Find the power and colours of a scene's lights from a picture.

    python launch/relight.py scene=data/scenes/roughness_spheres.json target=evening.exr
    python launch/relight.py scene=room.glb target=[a.png,b.png] cameras=[0,2] colours=false

Writes the scene with these lights, its images, and a sheet of before, target and after.
"""

from __future__ import annotations

import rfpp.interrupts  # noqa: F401 (first: what follows takes seconds to import)

# isort: split
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.table import Table

from rfpp import Renderer
from rfpp.commands import CONFIG_DIR, entry_point, required
from rfpp.errors import UserError
from rfpp.files import as_file_name
from rfpp.imaging.decoding import read_radiance
from rfpp.imaging.panels import error_map, panel, save_picture
from rfpp.imaging.tone_maps import ToneMap
from rfpp.inference.motion.frames import with_cameras
from rfpp.inference.relighting import Images, SolvedLights, solve_lights, with_factors
from rfpp.inference.stills import write_still
from rfpp.scene.io.loading import load_scene
from rfpp.scene.io.saving import fits_json, save_scene
from rfpp.training.tracking.registry import checkpoint_file


@entry_point("relight", CONFIG_DIR / "render")
def main(cfg: DictConfig) -> Path:
    """Solve for the lights of `cfg.scene`; returns the scene file that has them."""
    console = Console(highlight=False, soft_wrap=True)
    path, targets = Path(required(cfg, "scene")), _listed(required(cfg, "target"))
    how = {name: cfg[name] for name in ("triangles", "up", "transparent", "backdrop")}
    scene = load_scene(path, **how)
    cameras = list(range(len(targets))) if cfg.cameras is None else [int(camera) for camera in _listed(cfg.cameras)]
    if len(cameras) != len(targets):
        raise UserError(f"target: {len(targets)} pictures for cameras={cameras}: give one for each")
    seen = with_cameras(scene, path, cameras)
    if not seen.triangles.num_lights:
        raise UserError(f"{path}: nothing in it emits light: there is nothing to solve for")
    target, counts = _targets(targets, _listed(cfg.mask), cfg.exposure)

    file = checkpoint_file(str(cfg.checkpoint), cfg.registry.tracking_uri, Path(cfg.registry.folder))
    renderer = Renderer.load(file, cfg.device, cfg.precision)
    sampling = {name: cfg[name] for name in ("light_samples", "supersampling", "transports")}
    with console.status(f"Rendering {seen.triangles.num_lights} lights apart …"):
        layers = renderer.render_lights(seen, target.shape[1:3], **sampling)
    solved = solve_lights(layers, target, counts, cfg.colours, float(cfg.pull))

    console.print(_table(solved))
    for name in solved.unseen:
        console.print(f"warning: '{name}' is not seen in the target: it stays as it is")
    for one, other in solved.alike:
        console.print(f"warning: '{one}' and '{other}' light the target alike: only their sum is known")
    stem, tone_map = as_file_name(path.stem), instantiate(cfg.tone_map, stops=cfg.exposure)
    folder = Path(cfg.output)
    for view, image in enumerate(solved.images):
        write_still(image, folder / f"{stem}_relit_{view}.exr", tone_map)
    sheet = save_picture(_sheet(sum(layers.values()), target, solved, tone_map), folder / f"{stem}_relit.png")
    relit = with_factors(scene, solved.factors)
    written = save_scene(relit, folder / f"{stem}_relit.{'json' if fits_json(relit) else 'h5'}")
    console.print(f"Difference from the target: {solved.before:.1%} before, {solved.after:.1%} with these lights")
    console.print(f"  {written}, {sheet}, images of {len(target)} view{'s' * (len(target) > 1)} beside it")
    return written


def _listed(value: object) -> list[str]:
    plain = OmegaConf.to_container(value) if OmegaConf.is_config(value) else value
    return [] if plain is None else [str(item) for item in (plain if isinstance(plain, list) else [plain])]


def _targets(files: Sequence[str], masks: Sequence[str], stops: float) -> tuple[Images, np.ndarray]:
    """Radiance of all pictures and which pixels count. Raises UserError: of several sizes, or nothing counts."""
    pictures, known = zip(*(read_radiance(Path(file), stops) for file in files), strict=True)
    if len({picture.shape for picture in pictures}) > 1:
        raise UserError(f"target: {', '.join(files)} are of several sizes: give pictures of one")
    counts = np.stack(known)
    if masks:
        white = [read_radiance(Path(mask))[0].mean(-1) > 0.2 for mask in masks]  # half of what 8 bits hold
        if len(white) != len(files) or any(one.shape != counts.shape[1:] for one in white):
            raise UserError("mask: give one for each target, of its size")
        counts &= np.stack(white)
    if not counts.any():
        raise UserError(f"target: no pixel of {', '.join(files)} counts: all are clipped or masked")
    return np.stack(pictures), counts


def _table(solved: SolvedLights) -> Table:
    table = Table("light", "red ×", "green ×", "blue ×")
    for name, factor in solved.factors.items():
        table.add_row(name, *(f"{value:.3f}" for value in factor))
    return table


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
