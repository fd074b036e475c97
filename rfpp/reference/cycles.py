"""Reference images of packed triangles, path-traced by Blender Cycles. The only file that imports bpy.

Call it in a spawned worker process (`rfpp.reference.farm`): bpy holds one global scene and its own copies of many
libraries. The world is black, lights are invisible to the camera, and images are scene-linear radiance without a view
transform. Materials: see `rfpp.reference.blender_scene`.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from types import ModuleType

import numpy as np
from jaxtyping import Float

from rfpp.errors import MissingDependencyError, UserError
from rfpp.imaging.exr import ImageFileError, read_exr
from rfpp.ranges import NonNegative, NonNegativeFloat, Positive
from rfpp.reference.blender_scene import add_geometry
from rfpp.reference.texel_triangles import divided
from rfpp.scene.triangles import SceneTriangles

#: Passes of `render_passes`: name → (Blender's switch, layer name in its files, channels).
PASSES: dict[str, tuple[str, str, str]] = {
    "combined": ("use_pass_combined", "Combined", "RGB"),
    "depth": ("use_pass_z", "Depth", "Z"),
    "normal": ("use_pass_normal", "Normal", "XYZ"),
    "object_index": ("use_pass_object_index", "IndexOB", "X"),
    "diffuse_direct": ("use_pass_diffuse_direct", "DiffDir", "RGB"),
    "diffuse_indirect": ("use_pass_diffuse_indirect", "DiffInd", "RGB"),
    "diffuse_color": ("use_pass_diffuse_color", "DiffCol", "RGB"),
    "glossy_direct": ("use_pass_glossy_direct", "GlossDir", "RGB"),
    "glossy_indirect": ("use_pass_glossy_indirect", "GlossInd", "RGB"),
    "glossy_color": ("use_pass_glossy_color", "GlossCol", "RGB"),
}

_SYSTEM_LIBRARIES = "libxrender1 libxfixes3 libxi6 libxkbcommon0 libsm6 libgl1"


@dataclass(frozen=True)
class CyclesSettings:
    """All settings of a reference image. Values are in `conf/reference`.

    Attributes:
        samples: maximum number of paths per pixel.
        adaptive_threshold: noise level at which a pixel stops early; 0 disables adaptive sampling.
        denoise: OpenImageDenoise, high quality, guided by noisy albedo and normal.
        max_bounces, diffuse_bounces, glossy_bounces: path length, in total and by the kind of scattering.
        clamp_direct, clamp_indirect: maximum contribution of a sample; 0 is no limit. Clamping loses a few per cent of
            the energy and removes fireflies that more samples do not remove.
        caustics: light that reaches diffuse surfaces via glossy ones.
        blur_glossy: roughness added after a diffuse bounce, against noise from caustics.
        light_threshold: probabilistic (unbiased) termination of light samples weaker than this; 0 is off.
        filter_width: width of the Blackman-Harris pixel filter in pixels.
        seed: equal seeds give bit-identical images on a machine, for any number of threads.
        threads: 0 is one per core.
    """

    samples: Positive
    adaptive_threshold: NonNegativeFloat
    denoise: bool
    max_bounces: NonNegative
    diffuse_bounces: NonNegative
    glossy_bounces: NonNegative
    clamp_direct: NonNegativeFloat
    clamp_indirect: NonNegativeFloat
    caustics: bool
    blur_glossy: NonNegativeFloat
    light_threshold: NonNegativeFloat
    filter_width: float
    seed: NonNegative
    threads: NonNegative

    def __post_init__(self) -> None:
        for name, least in {field.name: int(field.name == "samples") for field in fields(self)}.items():
            if getattr(self, name) < least:
                raise UserError(f"reference.{name} is {getattr(self, name)}: use {least} or more")
        if not 0.01 <= self.filter_width <= 10:
            raise UserError(f"reference.filter_width is {self.filter_width}: use 0.01 to 10 pixels")


def require_blender() -> None:
    """Check in a subprocess that bpy loads. Raises MissingDependencyError with the remedy."""
    if importlib.util.find_spec("bpy") is None:
        raise _missing_blender("No module named 'bpy'")
    trial = subprocess.run([sys.executable, "-c", "import bpy"], capture_output=True, text=True, check=False)
    if trial.returncode != 0:
        raise _missing_blender((trial.stderr.strip().splitlines() or ["the import crashed"])[-1])


def render(
    triangles: SceneTriangles,
    c2w: Float[np.ndarray, "v 4 4"],
    fov: Float[np.ndarray, " v"],
    height: int,
    width: int,
    settings: CyclesSettings,
) -> Float[np.ndarray, "v h w 3"]:
    """Render the linear RGB radiance of every view.

    Args:
        triangles: World-space triangles.
        c2w: Camera to world, Blender axes.
        fov: Full angle in degrees along the longer image side.
        height: Rows of the image.
        width: Columns of the image.
        settings: Cycles settings.

    Raises:
        SceneError: If geometry is not finite or a triangle is degenerate.
        MissingDependencyError: If Blender is not installed or lacks a system library.
    """
    return render_passes(triangles, c2w, fov, height, width, settings, ["combined"])["combined"]


def render_passes(
    triangles: SceneTriangles,
    c2w: Float[np.ndarray, "v 4 4"],
    fov: Float[np.ndarray, " v"],
    height: int,
    width: int,
    settings: CyclesSettings,
    passes: Sequence[str],
) -> dict[str, np.ndarray]:
    """Render several Cycles passes (see `PASSES`) of every view: [V, H, W, 3], or [V, H, W] for scalars.

    Only "combined" is denoised. Depth is along the camera's -Z axis (1e10 where nothing is hit), normals are in world
    space, and object indices count from 1 (0 where nothing is hit). Raises like `render`.
    """
    bpy = _blender()
    with _quiet(), _memory_folder() as folder:
        _configure(_empty_scene(bpy), settings, height, width)
        _enable_passes(bpy.context.view_layer, passes)
        add_geometry(bpy, divided(triangles))
        views = [
            _render_view(bpy, pose, float(angle), folder / f"{view}.exr", passes)
            for view, (pose, angle) in enumerate(zip(c2w, fov, strict=True))
        ]
    return {name: np.stack([view[name] for view in views]) for name in passes}


def _configure(scene, settings: CyclesSettings, height: int, width: int) -> None:
    """Set everything that affects the image, independently of Blender's defaults."""
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = width, height, 100
    scene.render.threads_mode = "FIXED" if settings.threads else "AUTO"
    if settings.threads:
        scene.render.threads = settings.threads
    scene.render.film_transparent = False
    scene.render.use_compositing = scene.render.use_sequencer = False
    image = scene.render.image_settings
    if hasattr(image, "media_type"):  # since Blender 5
        image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format, image.color_depth, image.exr_codec = "OPEN_EXR_MULTILAYER", "32", "NONE"
    scene.view_settings.view_transform, scene.view_settings.look = "Raw", "None"
    scene.view_settings.exposure, scene.view_settings.gamma = 0.0, 1.0

    cycles = scene.cycles
    cycles.device = "CPU"
    cycles.samples = settings.samples
    cycles.use_adaptive_sampling = settings.adaptive_threshold > 0
    cycles.adaptive_threshold, cycles.adaptive_min_samples = settings.adaptive_threshold, 0
    cycles.use_denoising = settings.denoise
    cycles.denoiser, cycles.denoising_input_passes = "OPENIMAGEDENOISE", "RGB_ALBEDO_NORMAL"
    # at high quality, prefiltering costs time without improving the image
    cycles.denoising_prefilter, cycles.denoising_quality = "NONE", "HIGH"
    cycles.max_bounces, cycles.diffuse_bounces = settings.max_bounces, settings.diffuse_bounces
    cycles.glossy_bounces, cycles.transmission_bounces, cycles.volume_bounces = settings.glossy_bounces, 0, 0
    cycles.min_light_bounces = cycles.min_transparent_bounces = 0
    cycles.sample_clamp_direct, cycles.sample_clamp_indirect = settings.clamp_direct, settings.clamp_indirect
    cycles.caustics_reflective, cycles.caustics_refractive = settings.caustics, False
    cycles.blur_glossy = settings.blur_glossy
    cycles.light_sampling_threshold, cycles.use_light_tree = settings.light_threshold, True
    cycles.pixel_filter_type, cycles.filter_width = "BLACKMAN_HARRIS", settings.filter_width
    cycles.film_exposure = 1.0
    cycles.sampling_pattern, cycles.seed, cycles.use_animated_seed = "BLUE_NOISE", settings.seed, False
    scene.world = None  # black


def _enable_passes(view_layer, passes: Sequence[str]) -> None:
    if unknown := [name for name in passes if name not in PASSES]:
        raise UserError(f"Cycles pass '{unknown[0]}' is not known: choose from {', '.join(PASSES)}")
    for name, (switch, _, _) in PASSES.items():
        setattr(view_layer, switch, name in passes)


def _render_view(bpy: ModuleType, c2w: np.ndarray, fov: float, path: Path, passes: Sequence[str]) -> dict:
    """Render the scene from one camera and read the passes back from `path`."""
    scene = bpy.context.scene
    lens = bpy.data.cameras.new("camera")
    lens.type, lens.sensor_fit, lens.lens_unit = "PERSP", "AUTO", "FOV"
    lens.angle, lens.clip_start, lens.clip_end = float(np.radians(fov)), 1e-4, 1e4
    camera = bpy.data.objects.new("camera", lens)
    camera.matrix_world = c2w.T.astype(float).tolist()  # column-major
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.filepath = str(path)
    try:
        bpy.ops.render.render(write_still=True)
        layers = read_exr(path)  # on a full disk, Blender silently leaves a truncated file
    except (RuntimeError, ImageFileError) as error:
        raise UserError(f"{path.parent}: Cycles could not write an image there ({error}): free some space") from error
    path.unlink()
    bpy.data.objects.remove(camera)
    return {name: _pass(layers, *PASSES[name][1:]) for name in passes}


def _pass(layers: dict[str, np.ndarray], name: str, channels: str) -> np.ndarray:
    """Return one pass by Blender's names. The image library joins only R, G, B(, A) to one layer."""
    if channels == "RGB":
        return layers[f"ViewLayer.{name}"][..., :3]
    planes = [layers[f"ViewLayer.{name}.{channel}"] for channel in channels]
    return planes[0] if len(planes) == 1 else np.stack(planes, axis=-1)


def _empty_scene(bpy: ModuleType):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    shutil.rmtree(bpy.app.tempdir, ignore_errors=True)  # unused, and left behind when a worker exits
    return bpy.context.scene


@contextmanager
def _memory_folder() -> Iterator[Path]:
    """Provide a temporary folder, in memory if the system supports it."""
    parent = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with tempfile.TemporaryDirectory(prefix="rfpp_cycles_", dir=parent) as folder:
        yield Path(folder)


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress Blender's output, which is written to file descriptor 1 and bypasses `sys.stdout`."""
    sys.stdout.flush()
    kept, silence = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(silence, 1)
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(silence)


def _blender() -> ModuleType:
    try:
        import bpy
    except ImportError as error:
        raise _missing_blender(str(error)) from error
    return bpy


def _missing_blender(reason: str) -> MissingDependencyError:
    system, python = f"apt-get install {_SYSTEM_LIBRARIES}", 'pip install "rfpp[blender]" (Python 3.11 or 3.13)'
    remedy = system if ".so" in reason else python
    return MissingDependencyError(f"reference images need Blender ({reason}): {remedy}")
