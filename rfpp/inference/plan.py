"""What an image takes: its size, its samples, and what tokens see of it."""

from __future__ import annotations

from dataclasses import dataclass

from rfpp.errors import SceneError, UserError
from rfpp.inference.memory import require_memory
from rfpp.model.renderformer_pp import RenderFormerPP
from rfpp.scene.packed import PackedScene

#: Pixels along the longer side that ray tokens and image head see of finer images. What they say is smooth: at 256² the
#: error is at most 3% above that of all pixels (data/results/LOG.md).
TOKEN_RESOLUTION = 128


@dataclass(frozen=True)
class Plan:
    """What an image takes.

    Attributes:
        scene: with at least one camera.
        size: (height, width) in pixels.
        samples: of lights, of each pixel.
        points: along each side of a pixel.
        stride: pixels along each side of what tokens see as one.
        transports: see `Renderer.render`.
    """

    scene: PackedScene
    size: tuple[int, int]
    samples: int
    points: int
    stride: int
    transports: int | None

    @classmethod
    def of(
        cls,
        network: RenderFormerPP,
        scene: PackedScene,
        size: tuple[int, int],
        light_samples: int = 16,
        supersampling: int = 2,
        token_resolution: int | None = None,
        transports: int | None = None,
    ) -> Plan:
        """Arguments and errors: see `Renderer.render`."""
        if not len(scene.fov):
            raise SceneError(f"scene '{scene.name}' has no camera: add one to its `cameras`")
        if transports is not None and not network.iterations:
            raise UserError(f"transports={transports}: this network has no transport operator: leave it away")
        if token_resolution is None:
            token_resolution = TOKEN_RESOLUTION
        if min(light_samples, supersampling, token_resolution) < 1:
            given = f"light_samples={light_samples}, supersampling={supersampling}, token_resolution={token_resolution}"
            raise UserError(f"{given}: give 1 or more of each")
        points = supersampling if network.shades_points else 1
        require_memory(*size, points)
        return cls(scene, size, light_samples, points, stride_of(network, size, token_resolution), transports)


def image_size(network: RenderFormerPP, resolution: int | tuple[int, int]) -> tuple[int, int]:
    """(height, width) of a resolution. Raises UserError when it does not divide into the network's patches."""
    height, width = (resolution, resolution) if isinstance(resolution, int) else resolution
    patch = network.patch_size
    if min(height, width) < 1 or height % patch or width % patch:
        raise UserError(f"resolution {width} x {height} does not divide into patches of {patch}: use multiples")
    return height, width


def stride_of(network: RenderFormerPP, size: tuple[int, int], token_resolution: int) -> int:
    """Pixels along each side of what tokens see as one."""
    stride = 1
    while (
        network.sees_coarse_pixels
        and max(size) >= 2 * stride * token_resolution
        and not any(side % (2 * stride * network.patch_size) for side in size)
    ):
        stride *= 2
    return stride
