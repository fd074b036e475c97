"""The benchmarks of edits and of large scenes, small: what they count is exact, what they time is not tested."""

from itertools import pairwise

import numpy as np
import pytest
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from networks import SMALLEST, network

from rfpp.benchmark import large_scene
from rfpp.benchmark.editing import EDITS, measure
from rfpp.benchmark.memory import peak_resident
from rfpp.benchmark.spheres import sphere, spheres
from rfpp.commands import CONFIG_DIR
from rfpp.errors import UserError
from rfpp.scene.packed import pack


def test_edits_encode_what_changed_and_images_are_exact():
    made = []
    rows = measure(
        network(), triangles=60, objects=4, resolution=16, rounds=2, seed=0, device="cpu",
        progress=lambda *n: made.append(n),
    )  # fmt: skip
    assert [row["edit"] for row in rows] == list(EDITS)
    assert [row["objects_encoded"] for row in rows] == [0, 1, 1, 1, 0]
    for row in rows:
        assert row["max_difference"] == 0
        assert row["speedup"] == pytest.approx(row["anew_s"] / row["remembered_s"])
    assert made == [(i + 1, 10) for i in range(10)]


@pytest.mark.parametrize("edit", [name for name in EDITS if name != "none"])
def test_every_edit_is_visible(edit):
    scene, rng = spheres(60, 4, views=1, seed=0), np.random.default_rng(0)
    first, second = (pack(EDITS[edit](scene, rng)) for _ in range(2))
    for edited in (pack(scene), first):  # and every one is another
        assert not all(
            np.array_equal(getattr(edited.triangles, part), getattr(second.triangles, part))
            for part in ("positions", "material")
        ) or not np.array_equal(edited.c2w, second.c2w)


def test_a_large_scene_is_rendered_and_weighed():
    rows = large_scene.measure(
        network(), triangles=1000, objects=20, resolution=16, seed=0, device="cpu", progress=lambda *n: None
    )
    assert [row["step"] for row in rows] == ["triangles packed", "rendered", "rendered with an object moved"]
    peaks = [row["peak_GB"] for row in rows]
    # the kernel counts pages for each thread and adds them up now and then
    assert all(later > 0.999 * earlier for earlier, later in pairwise(peaks))
    assert 0.05e9 < 1e9 * peaks[-1] < 1.01 * peak_resident()


@pytest.mark.parametrize(("triangles", "objects"), [(60, 4), (62, 4), (6, 2), (1000, 28)])
def test_scenes_have_the_triangles_and_objects_asked_for(triangles, objects):
    packed = pack(spheres(triangles, objects, views=3, seed=1))
    assert len(packed.triangles) == triangles
    assert packed.triangles.num_objects == objects
    assert len(packed.fov) == 3
    sizes = np.diff(packed.triangles.object_offsets[:-1])
    assert sizes.max() - sizes.min() <= 2


@pytest.mark.parametrize(("triangles", "objects"), [(61, 4), (8, 4), (60, 1)])
def test_what_cannot_be_shared_out_is_refused(triangles, objects):
    with pytest.raises(UserError, match="ask for an even number"):
        spheres(triangles, objects, views=1, seed=0)


def test_a_sphere_is_closed_round_and_faces_outwards():
    mesh = sphere(200)
    corners = mesh.corners.astype(float)
    assert len(mesh) == 200
    volume = np.linalg.det(corners).sum() / 6
    assert 0.9 < volume / (4 / 3 * np.pi) < 1
    assert (np.linalg.det(corners) > 0).all()


@pytest.mark.parametrize("name", ["editing", "large_scene"])
def test_the_configuration_makes_a_benchmark_of_a_network(name):
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        cfg = compose("benchmark", overrides=[f"benchmark={name}", *SMALLEST])
    small = {"triangles": 60, "objects": 3, "resolution": 16}
    rows = instantiate(cfg.benchmark, _convert_="all")(**small, progress=lambda *n: None)
    assert rows[0]["parameters_M"] < 1
