"""Objects that are chosen from a library by their ids."""

import numpy as np
import pytest
from mesh_folders import fill, prepared, source

from rfpp.errors import SceneError
from rfpp.scene.mesh import joined
from rfpp.scene.sampling.objects.chosen import ChosenObjects
from rfpp.scene.sampling.objects.object_source import ObjectSource


@pytest.fixture(scope="module")
def objects(tmp_path_factory):
    """A source whose library is prepared."""
    folder = tmp_path_factory.mktemp("chosen")
    made = source(fill(folder / "meshes"), folder / "objects")
    prepared(made)
    return made


def drawn(chosen, count=20, held_out=False):
    rng = np.random.default_rng(0)
    return [joined(chosen.sample(rng, 200, held_out)) for _ in range(count)]


def test_only_what_was_chosen_is_drawn(objects):
    library = objects.library()
    two = library.part(False)[:2]
    found = {mesh.vertices.tobytes() for mesh in drawn(ChosenObjects(objects, [item.id for item in two]))}
    assert found == {joined(objects.sized(library, item, 200)).vertices.tobytes() for item in two} and len(found) == 2


def test_it_is_a_source_like_the_others(objects):
    [item] = objects.library().part(False)[:1]
    chosen = ChosenObjects(objects, [item.id])
    assert isinstance(chosen, ObjectSource) and chosen.libraries() == (objects,)
    assert chosen.account({"source": {}}) == {"ids": [item.id], "source": objects.account({})}
    assert all(199 <= len(mesh) <= 200 for mesh in drawn(chosen, 3))


def test_test_scenes_show_no_object_of_training_scenes(objects):
    [item] = objects.library().part(False)[:1]
    with pytest.raises(SceneError, match=f"'{item.id}' is none of its held-out objects"):
        drawn(ChosenObjects(objects, [item.id]), held_out=True)


def test_something_must_be_chosen(objects):
    with pytest.raises(SceneError, match=r"ids is empty"):
        ChosenObjects(objects, [])
