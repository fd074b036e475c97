"""What a network renders of stored scenes, beside their references: what a refinement learns from."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from hashlib import blake2b
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.utils.data import Dataset

from rfpp.errors import UserError
from rfpp.files import write_atomically
from rfpp.inference.gbuffers import GBufferSource
from rfpp.inference.renderer import Renderer
from rfpp.radiosity.refinement import Refinement
from rfpp.radiosity.sample_means import means
from rfpp.raycast.first_hit import CHANNELS
from rfpp.scene.packed import PackedScene
from rfpp.shards.dataset import ShardSplit

#: light_samples and supersampling of `Renderer.render`.
Sampling = tuple[int, int]


class RenderedViews(Dataset):
    """Views of a split as a network renders them, without refinement, and as they should be.

    Each view is rendered once, with one of several numbers of samples, and kept on disk: what was rendered before a
    stop is not rendered again.

    Args:
        renderer: of the network to be refined.
        split: scenes with references.
        samplings: one of them is drawn for each view.
        seed: of these draws.
        folder: of what is kept, for any network and data set.
        progress: called with (scenes rendered, scenes).
        scenes: of the split's the first so many; None: all.

    Raises:
        UserError: files cannot be written, or one is damaged.
        ShardError: like `ShardSplit`.
    """

    def __init__(
        self,
        renderer: Renderer,
        split: ShardSplit,
        samplings: Sequence[Sampling],
        seed: int,
        folder: Path,
        progress: Callable[[int, int], None],
        scenes: int | None = None,
    ):
        self.manifest = split.manifest
        what = repr((_digest(renderer.network), renderer.dtype, split.manifest.hash, split.split, samplings, seed))
        folder = folder / blake2b(what.encode(), digest_size=16).hexdigest()
        self.files: list[Path] = []
        count = len(split) if scenes is None else min(scenes, len(split))
        for index in range(count):
            progress(index, count)
            file = folder / f"{split.key(index)}.npz"
            if not file.exists():
                rng = np.random.default_rng([seed, index])
                write_atomically(file, _rendered(renderer, split, index, samplings, rng))
            self.files.append(file)
        progress(count, count)
        self.views = [(file, view) for file in self.files for view in range(_views(file))]

    def __len__(self) -> int:
        return len(self.views)

    def __getitem__(self, number: int) -> dict[str, Tensor]:
        """`radiance` and `reference` [3, H, W] linear, `surfaces` [13, H, W] of `Refinement.channels`, `fov` []."""
        file, view = self.views[number]
        with _opened(file) as stored:
            return {name: torch.from_numpy(stored[f"{name}_{view}"].astype(np.float32)) for name in _NAMES}


_NAMES = ("radiance", "reference", "surfaces", "fov")


def _rendered(
    renderer: Renderer, split: ShardSplit, index: int, samplings: Sequence[Sampling], rng: np.random.Generator
) -> bytes:
    sample = split.read(index, None, ())
    scene = PackedScene(sample.key, sample.triangles, sample.c2w, sample.fov)
    height, width = sample.images.shape[1:3]
    surfaces = GBufferSource(Refinement.channels)
    arrays: dict[str, np.ndarray] = {}
    for view, reference in enumerate(sample.images):
        light_samples, points = samplings[rng.integers(len(samplings))]
        seen = scene.views([view])
        [radiance] = renderer.views(
            seen, (height, width), light_samples=light_samples, supersampling=points, refined=False
        )
        of_points = torch.from_numpy(surfaces.of(seen, height, width, 1, points)(0))
        of_view = {
            "radiance": radiance.transpose(2, 0, 1),
            "reference": reference.transpose(2, 0, 1),
            "surfaces": means(of_points[None], points)[0].numpy(),
            "fov": scene.fov[view],
        }
        arrays |= {f"{name}_{view}": np.asarray(of_view[name], np.float16) for name in _NAMES}
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def _views(file: Path) -> int:
    """How many views a file holds."""
    with _opened(file) as stored:
        return len(stored.files) // len(_NAMES)


@contextmanager
def _opened(file: Path) -> Iterator[np.lib.npyio.NpzFile]:
    """Raises UserError where the file is none of ours, at once or when it is read."""
    try:
        with np.load(file, allow_pickle=False) as stored:
            yield stored
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
        raise UserError(f"{file}: is damaged: delete it, and it is rendered again") from None


def _digest(network: nn.Module) -> str:
    digest = blake2b(digest_size=16)
    for name, tensor in sorted(network.state_dict().items()):
        if not name.startswith("refinement."):
            digest.update(name.encode())
            digest.update(tensor.detach().cpu().float().numpy())
    return digest.hexdigest()


def augmented(view: dict[str, Tensor], generator: torch.Generator) -> dict[str, Tensor]:
    """With colours in another order, and mirrored every second time.

    Args:
        view: see `RenderedViews`.
    """
    colours, mirrored = torch.randperm(3, generator=generator), torch.rand((), generator=generator) < 0.5
    albedo, specular, roughness, normal, position = view["surfaces"].split([CHANNELS[n] for n in Refinement.channels])
    if mirrored:
        across = torch.tensor([-1.0, 1.0, 1.0])[:, None, None]
        normal, position = across * normal, across * position
    images = {
        "radiance": view["radiance"][colours],
        "reference": view["reference"][colours],
        "surfaces": torch.cat([albedo[colours], specular[colours], roughness, normal, position]),
    }
    return view | {name: image.flip(-1) if mirrored else image for name, image in images.items()}


class AugmentedViews(Dataset):
    """`augmented` views, others at each draw.

    Args:
        views: as they are.
        seed: of the changes.
    """

    def __init__(self, views: RenderedViews, seed: int):
        self.views, self._generator = views, torch.Generator().manual_seed(seed)

    def __len__(self) -> int:
        return len(self.views)

    def __getitem__(self, number: int) -> dict[str, Tensor]:
        return augmented(self.views[number], self._generator)
