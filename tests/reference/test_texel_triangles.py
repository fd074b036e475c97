"""Path-traced references show the textures that cameras see."""

import numpy as np
import pytest
from known_scenes import LIGHT, look_at, material, pack, square
from marks import requires_blender
from reference_presets import preset

from rfpp.raycast.first_hit import channel, first_hit
from rfpp.reference.cycles import CyclesSettings, render_passes
from rfpp.reference.texel_triangles import divided
from rfpp.scene.texels import NORMAL, Texels, rows_of
from rfpp.scene.triangles import SceneTriangles

POSE, FOV, SIDE = look_at((0, 0, 1.5), up=(0, 1, 0)), 40.0, 48
LEVELS = np.array([3, 2, 0, 0], np.int8)  # the floor's two triangles; light is never textured


def textured(varying: slice) -> SceneTriangles:
    """A floor with random texels in some columns, below a triangle and a lamp."""
    lamp = (LIGHT * 2.5 + [0.5, -0.5, 2.0], material(1.0, emission=2500.0))
    scene = pack((square(), material(0.5, 0.2)), (square(0.2, 0.1)[:1], material(0.9)), lamp)
    counts = rows_of(LEVELS)
    values = np.tile(np.float32([0.5] * 3 + [0.2] * 3 + [0.5, 0, 0, 1]), (counts.sum(), 1))
    rng = np.random.default_rng(0)
    values[:, varying] = rng.uniform(0.1, 0.8, (len(values), 10))[:, varying]
    values[:, NORMAL.stop - 1] = 1
    values[:, NORMAL] /= np.linalg.norm(values[:, NORMAL], axis=1, keepdims=True)
    texels = Texels(LEVELS, np.cumsum(counts) - counts, values.astype(np.float32))
    return SceneTriangles(**{**vars(scene), "texels": texels})


@pytest.mark.parametrize(
    ("varying", "name"),
    [(slice(0, 3), "albedo"), (slice(3, 6), "specular"), (slice(6, 7), "roughness"), (NORMAL, "normal")],
)
def test_cameras_see_the_same_on_triangles_as_on_texels(varying: slice, name: str):
    scene = textured(varying)
    fine = divided(scene)
    np.testing.assert_array_equal(np.diff(fine.object_offsets), [4**3 + 4**2, 1, 1])
    near = look_at((0, 0, 0.4), up=(0, 1, 0))  # where texels are larger than pixels
    seen = [channel(first_hit(of, near, FOV, SIDE, SIDE), of.material, FOV, name) for of in (scene, fine)]
    wrong = np.abs(seen[0] - seen[1]).max(-1) > 1e-3
    assert wrong.mean() < 0.02
    assert seen[0].reshape(SIDE**2, -1).std(axis=0).max() > 0.03


def test_a_scene_without_texels_is_unchanged():
    scene = pack((square(), material(0.5)))
    assert divided(scene) is scene


@requires_blender
def test_blender_sees_texels(in_process):
    scene = textured(slice(0, 7))
    near = look_at((0, 0, 0.4), up=(0, 1, 0))[None].astype(np.float32)
    passes = in_process(
        render_passes,
        scene,
        near,
        np.float32([FOV]),
        SIDE,
        SIDE,
        CyclesSettings(**preset("preview")),
        ["diffuse_color"],
    )
    gbuffer = first_hit(scene, near[0], FOV, SIDE, SIDE)
    albedo = channel(gbuffer, scene.material, FOV, "albedo")
    assert np.median(np.abs(passes["diffuse_color"][0] - albedo)) < 0.01
