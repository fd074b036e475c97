import numpy as np
import pytest
from scene_families import draw, family, objects, scenes

from rfpp.errors import SceneError
from rfpp.scene.sampling.family import TriangleBudget, shared_out
from rfpp.scene.triangles import SceneTriangles

QUICKSTART = family("quickstart")
#: Family → scenes to draw, and its intervals of triangles, of objects and of triangles of an object.
BUDGETS = {
    "quickstart": (20, (400, 1600), (3, 8), (50, 300)),
    "renderformer": (6, (500, 4096), (1, 3), (200, 1188)),
    "small_scale": (3, (3000, 10000), (5, 70), (200, 1200)),
    "large_scale": (1, (10000, 80000), (5, 70), (200, 1200)),
}


def same(a, b):
    return (
        a.material == b.material
        and a.transform == b.transform
        and np.array_equal(a.mesh.vertices, b.mesh.vertices)
        and np.array_equal(a.mesh.faces, b.mesh.faces)
    )


@pytest.mark.parametrize("name", BUDGETS)
def test_the_triangle_budget_is_kept(name):
    count, (low, high), (fewest, most), (smallest, largest) = BUDGETS[name]
    for scene in scenes(name, count):
        assert low <= sum(len(item.mesh) for item in scene.objects) <= high
        assert len(SceneTriangles.from_scene(scene)) == sum(len(item.mesh) for item in scene.objects)
        items = objects(scene, "object")
        assert fewest <= len(items) <= most
        assert all(smallest <= len(item.mesh) <= largest for item in items)
        assert {len(item.mesh) for item in objects(scene, "background")} == {128}


@pytest.mark.parametrize("total", [2000, 2001, 7000, 11999, 12000])
def test_shares_add_up_and_differ(total):
    shares = shared_out(np.random.default_rng(0), total, 10, 200, 1200)
    assert len(shares) == 10
    assert shares.sum() == total // 2 * 2
    assert shares.min() >= 200
    assert shares.max() <= 1200
    if total == 7000:
        assert shares.std() > 150


def test_odd_limits_of_an_object_are_kept_too():
    budget = TriangleBudget(scene=(200, 2000), objects=(3, 8), per_object=(51, 301))
    rng = np.random.default_rng(0)
    targets = np.concatenate([budget.sample(rng, taken=129) for _ in range(200)])
    assert targets.min() == 52
    assert targets.max() <= 300
    assert (targets % 2 == 0).all()


def test_a_budget_that_cannot_be_met_is_refused_with_its_numbers():
    budget = TriangleBudget(scene=(100, 200), objects=(3, 8), per_object=(50, 300))
    with pytest.raises(SceneError, match=r"3…8 objects of 50…300 triangles and 512 .* cannot make 100…200"):
        budget.sample(np.random.default_rng(0), taken=512)


def test_the_same_seeds_give_the_same_scene_and_others_another():
    first, again, other = draw(QUICKSTART, 5, 6), draw(QUICKSTART, 5, 6), draw(QUICKSTART, 7, 6)
    assert first.cameras == again.cameras
    assert len(first.objects) == len(again.objects)
    assert all(same(a, b) for a, b in zip(first.objects, again.objects, strict=True))
    assert not all(same(a, b) for a, b in zip(first.objects, other.objects, strict=False))


def test_the_camera_rng_moves_cameras_and_nothing_else():
    first, other = draw(QUICKSTART, 5, 6), draw(QUICKSTART, 5, 7)
    assert all(same(a, b) for a, b in zip(first.objects, other.objects, strict=True))
    assert not set(first.cameras) & set(other.cameras)


def test_cameras_depend_on_the_background_alone_and_not_on_what_else_the_scene_rng_draws():
    few, many = family("quickstart", "family.budget.objects=[3,3]"), family("quickstart", "family.budget.objects=[8,8]")
    assert draw(few, 5, 6).cameras == draw(many, 5, 6).cameras


def test_changing_one_component_leaves_the_others_as_they_were():
    shiny = family("quickstart", "family.materials.specular_share=[1.0,1.0]")
    for before, after in zip(draw(QUICKSTART, 5, 6).objects, draw(shiny, 5, 6).objects, strict=True):
        assert before.transform == after.transform
        assert np.array_equal(before.mesh.vertices, after.mesh.vertices)
        assert (before.material == after.material) != before.name.startswith("object_")


def test_names_are_those_of_renderformer_and_transforms_need_no_normalization():
    scene = draw(QUICKSTART, 1, 1)
    assert scene.name == "quickstart"
    assert [kind for kind in ("background", "object", "light") for _ in objects(scene, kind)] == [
        item.name.rsplit("_", 1)[0] for item in scene.objects
    ]
    assert not any(item.transform.normalize for item in scene.objects)
    assert all(item.material.is_emissive == item.name.startswith("light_") for item in scene.objects)
