"""Download one hash-pinned source package with pip.

pip runs a source package's build script even to download it. `--require-hashes` ensures that it is the script that was
reviewed; anything else is refused unopened.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path


class DownloadError(Exception):
    """pip is missing or the download failed."""


def download_sdist(name: str, version: str, sha256: str) -> bytes:
    """Download `<name>-<version>.tar.gz` with this hash from the indexes that pip is configured to use.

    Raises:
        DownloadError: If pip fails, with its message in one line.
    """
    with tempfile.TemporaryDirectory() as folder:
        requirements = Path(folder) / "requirements.txt"
        requirements.write_text(f"{name}=={version} --hash=sha256:{sha256}\n")
        options = ["--require-hashes", "--no-deps", f"--no-binary={name}", "--no-input", "--disable-pip-version-check"]
        command = [sys.executable, "-m", "pip", "download", *options, "-r", str(requirements), "-d", folder]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise DownloadError(f"pip download {name}=={version}: {_reason(done.stderr)}")
        return next(Path(folder).glob("*.tar.gz")).read_bytes()


def _reason(output: str) -> str:
    """Return the first error in pip's output, else its last line. pip hides passwords in URLs."""
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    errors = [line.removeprefix("ERROR: ") for line in lines if line.startswith("ERROR: ")]
    return (errors or lines[-1:] or ["no answer"])[0]
