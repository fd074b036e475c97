from pathlib import Path

import numpy as np
import pytest
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from mesh_folders import fill, prepared
from scene_families import draw, family, objects

from rfpp.scene.mesh import joined
from rfpp.scene.sampling.objects.folder import FolderObjects
from rfpp.scene.sampling.objects.objaverse import ObjaverseObjects
from rfpp.scene.sampling.objects.procedural import KINDS, ProceduralObjects
from rfpp.scene.sampling.objects.refinement import is_closed

CONF = Path(__file__).parents[4] / "conf"
FAMILIES = ["quickstart", "small_scale", "large_scale", "renderformer"]


def generated(*overrides):
    """The scene family that `launch/generate.py` makes of a command line."""
    with initialize_config_dir(config_dir=str(CONF), version_base="1.3"):
        return instantiate(compose("generate", list(overrides)).family, _convert_="all")


@pytest.mark.parametrize("name", FAMILIES)
def test_every_family_shows_all_kinds_of_one_pool(name):
    source = family(name).objects
    assert source == family("quickstart").objects
    assert isinstance(source, ProceduralObjects)
    assert set(source.kinds) == set(KINDS)
    assert source.training_objects == 90000
    assert source.account({"pool": 7}) == {"pool": 7}


@pytest.mark.parametrize("experiment", ["quickstart", "small_scale", "large_scale", "renderformer_data"])
def test_a_folder_or_objaverse_takes_the_place_on_the_command_line(tmp_path, experiment):
    command = [f"experiment={experiment}", f"family.objects.root={tmp_path}"]
    folder = generated(*command, "family/objects=folder", "family.objects.folder=/my/meshes").objects
    assert isinstance(folder, FolderObjects)
    assert folder.library_root == tmp_path / "meshes"
    uids = generated(*command, "family/objects=objaverse", "family.objects.uids=/my/chairs.txt").objects
    assert isinstance(uids, ObjaverseObjects)
    assert uids.preparation == folder.preparation
    assert uids.preparation.max_faces >= 1200  # what scenes ask for is not refined needlessly


def test_scenes_of_a_folder_keep_test_meshes_for_test_scenes(tmp_path):
    overrides = ["family/objects=folder", f"family.objects.folder={fill(tmp_path / 'meshes')}"]
    source = generated("experiment=quickstart", *overrides, f"family.objects.root={tmp_path / 'objects'}")
    library = prepared(source.objects)
    boxes = {
        held_out: {
            tuple(np.sort(np.ptp(joined(library.parts(item)).vertices, axis=0)).round(2))
            for item in library.part(held_out)
        }
        for held_out in (False, True)
    }
    assert boxes[True].isdisjoint(boxes[False])
    for held_out in (False, True):
        for seed in range(8):
            scene = draw(source, [seed, 0], [seed, 1], held_out)
            assert 400 <= sum(len(item.mesh) for item in scene.objects) <= 1600
            for item in objects(scene, "object"):
                assert is_closed(item.mesh)
                assert 50 <= len(item.mesh) <= 300
