"""Render for Blender: a server for the add-on of `launch/addon.py`.

    python launch/serve.py
    python launch/serve.py checkpoint=data/runs/quickstart/latest/checkpoints/best.ckpt port=8701

It listens on 127.0.0.1 unless host=0.0.0.0 is given, and refuses requests of web pages.
"""

from __future__ import annotations

import rfpp.interrupts  # noqa: F401 (first, because the imports below take seconds)

# isort: split
import threading
from pathlib import Path

from omegaconf import DictConfig
from rich.console import Console

from rfpp import Renderer
from rfpp.commands import CONFIG_DIR, entry_point
from rfpp.training.tracking.registry import checkpoint_file


@entry_point("serve", CONFIG_DIR / "serve")
def main(cfg: DictConfig) -> None:
    """Serve until Ctrl-C."""
    from rfpp.serve.server import Server  # needs an extra

    checkpoint = checkpoint_file(cfg.checkpoint, cfg.registry.tracking_uri, Path(cfg.registry.folder))
    renderer = Renderer.load(checkpoint, cfg.device, cfg.precision)
    console = Console(highlight=False, soft_wrap=True)
    with Server(renderer, cfg.host, cfg.port, int(cfg.max_megabytes * 2**20), console.print) as server:
        console.print(f"{server.url}   (Ctrl-C stops it)")
        try:
            threading.Event().wait()
        except KeyboardInterrupt:
            console.print("Closed.")


if __name__ == "__main__":
    main()
