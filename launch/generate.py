"""Generate a data set: random scenes → Blender Cycles and G-buffers → WebDataset shards.

    python launch/generate.py experiment=quickstart
    python launch/generate.py experiment=large_scale preview=16
    python launch/generate.py experiment=quickstart action=show sample=train-000012

To resume, run the same command again: finished scenes are kept. Other actions: `merge` joins slices, `status` lists
missing samples, `verify` hashes and decodes everything, `prepare` builds the object library, `reproduce` makes one
sample, `show` draws one, `export` writes one for other programs. h5.folder=… imports RenderFormer's H5 files.
"""

from __future__ import annotations

import rfpp.interrupts  # noqa: F401 (first: the other imports take seconds)

# isort: split
import time
from pathlib import Path
from typing import Any

import numpy as np
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from rfpp.commands import entry_point
from rfpp.errors import ShardError, UserError
from rfpp.imaging.panels import save_picture
from rfpp.progress import counting
from rfpp.scene.sampling.objects.library import INDEX, Library
from rfpp.scene.sampling.objects.library_building import prepare
from rfpp.scene.sampling.objects.library_objects import LibraryObjects
from rfpp.shards.dataset import find_sample
from rfpp.shards.export import export
from rfpp.shards.generation import make, merge
from rfpp.shards.manifest import Manifest
from rfpp.shards.pictures import contact_sheet, sample_panel
from rfpp.shards.recipe import Recipe, Slice
from rfpp.shards.renderformer_data import Import
from rfpp.shards.sample import SceneSample, decode
from rfpp.shards.status import Status, status
from rfpp.shards.tar import unpack
from rfpp.shards.verification import verify


@entry_point("generate", built=("data", "family", "farm", "reference"))
def main(cfg: DictConfig) -> Any:
    """Apply `cfg.action` to the data set `cfg.data`; returns the result of the action."""
    console = Console(highlight=False, soft_wrap=True)
    if cfg.preview:
        return _preview(cfg, console)
    if cfg.action not in ACTIONS:
        raise UserError(f"action={cfg.action} does not exist: choose from {', '.join(ACTIONS)}")
    return ACTIONS[cfg.action](cfg, console)


def _recipe(cfg: DictConfig) -> Recipe:
    data = instantiate(cfg.data, _convert_="all")
    if cfg.h5.folder is not None:
        return Import(Path(cfg.h5.folder), cfg.h5.validation, cfg.h5.test).recipe(data)
    family = instantiate(cfg.family, _convert_="all")
    scene, reference = (OmegaConf.to_container(cfg[group], resolve=True) for group in ("family", "reference"))
    scene["objects"] = family.objects.account(scene["objects"])
    groups = {"scene": scene, "reference": reference}  # part of every data set's fingerprint
    return Recipe.of_scenes(family, instantiate(cfg.reference), data, groups)


def _prepare(cfg: DictConfig, console: Console) -> list[Library]:
    """Import meshes into their libraries; unchanged files are skipped."""
    sources = instantiate(cfg.family.objects, _convert_="all").libraries()
    if not sources:
        raise UserError(
            "family.objects: procedural objects need no preparation: "
            "choose family/objects=folder, furniture or objaverse"
        )
    return [_prepared(source, cfg, console) for source in sources]


def _prepared(source: LibraryObjects, cfg: DictConfig, console: Console) -> Library:
    with counting(console, "objects") as (show, _), instantiate(cfg.farm) as farm:
        library = prepare(source, farm.map, show)
    counts = ", ".join(f"{count} {name}" for name, count in library.index.counts.items())
    console.print(f"Objects in {library.root}: {counts}.")
    for rejected in library.index.rejected[:20]:
        console.print(f"  {rejected.id}: {rejected.reason}: {rejected.detail}", markup=False)
    if len(library.index.rejected) > 20:
        console.print(f"  and {len(library.index.rejected) - 20} more, in {library.root / INDEX}")
    return library


def _make(cfg: DictConfig, console: Console) -> Manifest | None:
    for source in instantiate(cfg.family.objects, _convert_="all").libraries():
        if not source.is_prepared():
            _prepared(source, cfg, console)
    recipe, part = _recipe(cfg), Slice(**cfg.slice)
    console.print(f"Data set '{recipe.name}' → {recipe.root}")
    begin = time.perf_counter()
    try:
        with counting(console, "images", recipe.views) as (show, count), instantiate(cfg.farm) as farm:
            make(recipe, farm, show, part)
    except KeyboardInterrupt:
        raise KeyboardInterrupt("run the same command again to resume; finished scenes are kept") from None
    if count.made:
        console.print(f"Generated {count.made} scenes in {time.perf_counter() - begin:.0f} s.")
    else:
        console.print(f"Nothing to do: all {count.total} scenes exist.")
    if part.count > 1:
        console.print(f"Slice {part.index} of {part.count} is finished; when all are, run action=merge.")
        return None
    return _merge(cfg, console)


def _merge(cfg: DictConfig, console: Console) -> Manifest:
    manifest = merge(_recipe(cfg))
    counts = manifest.counts
    console.print(
        f"Total: {counts['scenes']} scenes, {counts['images']} images, {counts['triangles']} triangles, "
        f"{counts['bytes'] / 1e6:.0f} MB; redrawn: {counts['scene_redraws']} scenes, {counts['empty_views']} views "
        f"with too little surface, {counts['unlit_views']} with too little light.\n"
        f"Manifest {manifest.hash[:12]}: {manifest.root}/manifest.json"
    )
    return manifest


def _status(cfg: DictConfig, console: Console) -> Status:
    found = status(_recipe(cfg))
    for split, of in found.splits.items():
        console.print(
            f"{split:15} {of.finished_shards:5} of {of.shards} shards, {of.finished_scenes + of.waiting_scenes:7} of "
            f"{of.scenes} scenes" + f", {len(of.failures)} failed" * bool(of.failures)
        )
        for key, error in of.failures.items():
            console.print(f"  {key}: {error}", markup=False)
    if left := found.slices(cfg.slice.count):
        console.print(f"Unfinished: slices {', '.join(map(str, left))} of {cfg.slice.count}.")
    else:
        console.print("Complete." if found.is_merged else "All shards are finished: join them with action=merge.")
    return found


def _verify(cfg: DictConfig, console: Console) -> None:
    with counting(console, "shards") as (show, _), instantiate(cfg.farm) as farm:
        problems = verify(Path(cfg.data.root), farm, show)
    for problem in problems:
        console.print(problem, markup=False)
    if problems:
        raise ShardError(f"{cfg.data.root}: {len(problems)} problems, listed above: fix them and verify again")
    console.print(f"{cfg.data.root}: all checksums match the manifest, and every sample decodes.")


def _sample(cfg: DictConfig) -> str:
    if cfg.sample is None:
        raise UserError(f"action={cfg.action} needs a sample: add sample=<key>, for example sample=train-000000")
    return cfg.sample


def _reproduce(cfg: DictConfig, console: Console) -> SceneSample:
    """Make a sample in this process, so that a failure shows its full traceback."""
    recipe = _recipe(cfg)
    task = recipe.task(_sample(cfg))
    key, members = unpack(recipe.job(task).blocks)
    return _save_panel(decode(key, members), cfg, console)


def _show(cfg: DictConfig, console: Console) -> SceneSample:
    return _save_panel(find_sample(Path(cfg.data.root), _sample(cfg)), cfg, console)


def _save_panel(sample: SceneSample, cfg: DictConfig, console: Console) -> SceneSample:
    console.print(f"Written: {save_picture(sample_panel(sample), Path(cfg.output) / f'{sample.key}.png')}")
    return sample


def _export(cfg: DictConfig, console: Console) -> list[Path]:
    files = export(find_sample(Path(cfg.data.root), _sample(cfg)), cfg.format, Path(cfg.output))
    console.print("Written: " + ", ".join(map(str, files)))
    return files


def _preview(cfg: DictConfig, console: Console) -> Path:
    """Draw a contact sheet of random scenes, before rendering any data."""
    family = instantiate(cfg.family, _convert_="all")
    with counting(console, "scenes") as (show, _):
        scenes = []
        for index in range(cfg.preview):
            rngs = (np.random.default_rng([cfg.data.seed, index, stream]) for stream in range(2))
            scenes.append(family.sample(*rngs, held_out=False))
            show(index + 1, cfg.preview)
    path = save_picture(contact_sheet(scenes, 256), Path(cfg.output) / f"{cfg.family.name}_preview.png")
    console.print(f"Written: {path}")
    return path


ACTIONS = {
    "make": _make,
    "prepare": _prepare,
    "merge": _merge,
    "status": _status,
    "verify": _verify,
    "show": _show,
    "export": _export,
    "reproduce": _reproduce,
}


if __name__ == "__main__":
    main()
