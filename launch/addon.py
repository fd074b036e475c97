"""Write Blender's add-on as an extension, a zip file to install from disk.

    python launch/addon.py
    python launch/addon.py output=~/Downloads

In Blender 4.2 to 5.2: Preferences, Get Extensions, the arrow at the right, Install from Disk. Then `launch/serve.py`.
"""

from __future__ import annotations

import rfpp.interrupts  # noqa: F401 (first, because the imports below take seconds)

# isort: split
from pathlib import Path

from omegaconf import DictConfig

from rfpp.commands import CONFIG_DIR, entry_point
from rfpp.serve.extension import write_extension


@entry_point("addon", CONFIG_DIR / "serve")
def main(cfg: DictConfig) -> Path:
    """Write the add-on to `cfg.output` and return its path."""
    path = write_extension(Path(cfg.output).expanduser())
    print(f"{path}   (Blender: Preferences, Get Extensions, Install from Disk)")
    return path


if __name__ == "__main__":
    main()
