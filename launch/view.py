"""Look at a scene and edit it in a browser.

    python launch/view.py scene=data/scenes/cornell_box.json
    python launch/view.py scene=chair.glb checkpoint=data/runs/quickstart/latest/checkpoints/best.ckpt

Drag to turn, scroll to zoom, drag with the right button to move. The page is served to this machine only, unless
host=0.0.0.0 is given: whoever opens it uses this machine's processor.
"""

from __future__ import annotations

import rfpp.interrupts  # noqa: F401 (first, because the imports below take seconds)

# isort: split
import threading
from pathlib import Path

from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from rfpp import Renderer
from rfpp.commands import entry_point, settings
from rfpp.imaging.tone_maps import TONE_MAPS
from rfpp.inference.scene_settings import LoadSettings, as_list
from rfpp.raycast.compiled import announce_compilation
from rfpp.training.tracking.registry import checkpoint_file


@entry_point("view")
def main(cfg: DictConfig) -> None:
    """Serve the page until Ctrl-C."""
    from rfpp.viewer.server import Viewer  # needs an extra

    scene = LoadSettings.parse(OmegaConf.to_container(cfg, resolve=True)).load(Path(cfg.scene))
    checkpoint = checkpoint_file(cfg.checkpoint, cfg.registry.tracking_uri, Path(cfg.registry.folder))
    renderer = Renderer.load(checkpoint, cfg.device, cfg.precision)
    viewer = Viewer(
        renderer,
        scene,
        TONE_MAPS,
        instantiate(settings("reference", "reference_settings", cfg.reference_settings, without=["radiosity"])),
        host=cfg.host,
        port=cfg.port,
        longer_side=max(as_list(cfg.resolution) or renderer.info.resolution),
        moving_seconds=cfg.moving_seconds,
    )
    console = Console(highlight=False, soft_wrap=True)
    announce_compilation(console.print)
    with viewer:
        console.print(f"{viewer.url}   (Ctrl-C stops it)")
        try:
            threading.Event().wait()
        except KeyboardInterrupt:
            console.print("Closed.")


if __name__ == "__main__":
    main()
