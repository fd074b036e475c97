"""Render for Blender: a server on this machine that the add-on of `launch/addon.py` sends its scenes to.

    python launch/serve.py
    python launch/serve.py checkpoint=data/runs/quickstart/latest/checkpoints/best.ckpt port=8701

Only programs on this machine are answered unless host=0.0.0.0 says otherwise, and no web page is.
"""

from __future__ import annotations

import rfpp.interrupts  # noqa: F401 (first: what follows takes seconds to import)

# isort: split
import threading
from pathlib import Path

from omegaconf import DictConfig
from rich.console import Console

from rfpp import Renderer
from rfpp.commands import CONFIG_DIR, entry_point
from rfpp.serve.server import Server
from rfpp.serve.studio import Studio
from rfpp.training.tracking.registry import checkpoint_file


@entry_point("serve", CONFIG_DIR / "serve")
def main(cfg: DictConfig) -> None:
    """Serve until Ctrl-C."""
    checkpoint = checkpoint_file(str(cfg.checkpoint), cfg.registry.tracking_uri, Path(cfg.registry.folder))
    studio = Studio(Renderer.load(checkpoint, cfg.device, cfg.precision))
    console = Console(highlight=False, soft_wrap=True)
    with Server(studio, cfg.host, cfg.port, int(cfg.max_megabytes * 2**20), console.print) as server:
        console.print(f"{server.url}   (Ctrl-C ends it)")
        try:
            threading.Event().wait()
        except KeyboardInterrupt:
            console.print("Closed.")


if __name__ == "__main__":
    main()
