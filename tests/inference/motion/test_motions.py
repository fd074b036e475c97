"""Motions: turntable, camera path, keyframes and numbered scenes."""

import json
from pathlib import Path

import numpy as np
import pytest
from edited_scenes import scene
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rfpp.errors import SceneError, UserError
from rfpp.inference.motion import CameraPath, Keyframes, NumberedScenes, Swing, Turntable
from rfpp.inference.motion.frames import with_cameras
from rfpp.scene.camera import camera_to_world
from rfpp.scene.io.loading import load_scene
from rfpp.scene.io.renderformer_h5 import save_h5
from rfpp.scene.io.saving import save_scene
from rfpp.scene.packed import pack
from rfpp.scene.spec import Camera, rotation_matrix
from rfpp.scene.triangles import EMISSION


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """Six objects, three cameras."""
    return save_scene(scene(), tmp_path_factory.mktemp("scene") / "six.json")


@pytest.fixture
def keys(tmp_path):
    """`keys(content)`: the path of a file of keyframes."""

    def write(content, name="flight.json"):
        (tmp_path / name).write_text(content if isinstance(content, str) else json.dumps(content))
        return tmp_path / name

    return write


def of_object(frame, name, columns):
    number = frame.triangles.object_names.index(name)
    return columns[slice(*frame.triangles.object_offsets[number : number + 2])]


class TestTurntable:
    def test_the_circle_closes(self, file):
        frames = Turntable(frames=12).frames_of(file, camera=1)
        assert len(frames) == 12
        poses = np.stack([frame.c2w[0] for frame in frames]).astype(np.float64)
        np.testing.assert_array_equal(poses[0], pack(load_scene(file)).c2w[1])
        steps = [b @ np.linalg.inv(a) for a, b in zip(poses, [*poses[1:], poses[0]], strict=True)]
        for step in steps:  # the last one, back to the first, like all others
            np.testing.assert_allclose(step, steps[0], atol=1e-6)
        np.testing.assert_allclose(steps[0][:3, :3], rotation_matrix((0.0, 0.0, 30.0)), atol=1e-6)

    def test_height_and_distance_stay(self, file):
        frames = Turntable(frames=7).frames_of(file, camera=0)
        visible = frames[0].triangles.positions[~frames[0].triangles.is_emissive].reshape(-1, 3)
        middle = (visible.min(axis=0) + visible.max(axis=0)) / 2
        places = np.stack([frame.c2w[0, :3, 3] for frame in frames])
        np.testing.assert_allclose(places[:, 2], places[0, 2], atol=1e-6)
        distances = np.linalg.norm(places - middle, axis=1)
        np.testing.assert_allclose(distances, distances[0], atol=1e-5)
        assert len({frame.fov.item() for frame in frames}) == 1

    def test_only_the_camera_moves(self, file):
        frames = Turntable(frames=3).frames_of(file, camera=0)
        assert frames[0].triangles is frames[2].triangles
        with pytest.raises(IndexError):
            frames[3]

    @pytest.mark.parametrize("frames", [0, -3, "many"])
    def test_a_turn_of_no_frames_is_refused(self, frames):
        with pytest.raises(SceneError, match=r"^motion\.frames: "):
            Turntable(frames=frames)


def test_a_swing_goes_to_both_sides_and_comes_back(file):
    frames = Swing(frames=8, degrees=40).frames_of(file, camera=1)
    pose = frames[0].c2w[0].astype(np.float64)
    np.testing.assert_array_equal(pose, pack(load_scene(file)).c2w[1])
    for number, angle in ((2, 20.0), (4, 0.0), (6, -20.0)):
        turned = frames[number].c2w[0] @ np.linalg.inv(pose)
        np.testing.assert_allclose(turned[:3, :3], rotation_matrix((0.0, 0.0, angle)), atol=1e-6)


class TestCameraPath:
    KEYS = (
        {"time": 1, "position": [0, -2, 0.5], "look_at": [0, 0, 0], "fov": 40},
        {"time": 1.5, "position": [1, -1.5, 0.8], "look_at": [0.1, 0, 0], "fov": 30},
        {"time": 3, "position": [2, 0, 0.5], "look_at": [0, 0, 0.1], "fov": 50},
    )

    def test_it_passes_through_its_keys_on_time(self, file, keys):
        frames = CameraPath(file=keys({"camera": self.KEYS}), fps=4).frames_of(file, camera=0)
        assert len(frames) == 9
        for key in self.KEYS:
            frame = frames[int(4 * (key["time"] - 1))]
            camera = Camera(**{name: value for name, value in key.items() if name != "time"})
            np.testing.assert_allclose(frame.c2w[0], camera_to_world(camera), atol=1e-6)
            assert frame.fov[0] == pytest.approx(camera.fov)
        assert frames[0].triangles is frames[8].triangles

    def test_yaml_says_the_same_as_json(self, file, keys):
        text = "camera:\n" + "".join(f"  - {json.dumps(key)}  # as it is\n" for key in self.KEYS)
        yaml = CameraPath(file=keys(text, "flight.yaml"), fps=2).frames_of(file, camera=0)
        same = CameraPath(file=keys({"camera": self.KEYS}), fps=2).frames_of(file, camera=0)
        np.testing.assert_array_equal([f.c2w for f in yaml], [f.c2w for f in same])

    def test_keys_out_of_order_are_refused_with_the_file(self, file, keys):
        path = keys({"camera": self.KEYS[::-1]})
        with pytest.raises(SceneError, match=r"flight\.json: camera: time 1\.5 follows 3: put the keys in order"):
            CameraPath(file=path, fps=24).frames_of(file, camera=0)

    @pytest.mark.parametrize(
        ("content", "named"),
        [
            ('{"camera": []}', "there is no key"),
            ('{"camera": [{"time": 0}]}', "camera: key 0: position: this key is missing"),
            ('{"camera": [{"time": 1e30, "position": [0, -2, 0], "look_at": [0, 0, 0], "fov": 40}]}', "key 0: time"),
            ('{"camera": [{"time": NaN, "position": [0, -2, 0], "look_at": [0, 0, 0], "fov": 40}]}', "finite"),
            ('{"camera": [{"time": 0, "position": [0, 0, 0], "look_at": [0, 0, 0], "fov": 40}]}', "looks nowhere"),
            ('{"camera": [{"time": 0, "position": [0, -2, 0], "look_at": [0, 0, 0], "fov": 400}]}', "fov"),
            ('{"cameras": []}', "camera: this key is missing"),
            ('{"camera": ', "line 1: malformed JSON"),
            ("[1, 2]", "is not a JSON object"),
        ],
    )
    def test_a_bad_file_is_one_line_with_its_name(self, content, named, file, keys):
        with pytest.raises(SceneError) as refused:
            CameraPath(file=keys(content), fps=24).frames_of(file, camera=0)
        assert "flight.json: " in str(refused.value)
        assert named in str(refused.value)
        assert "\n" not in str(refused.value)

    @pytest.mark.parametrize(
        ("content", "named"),
        [
            ("camera: [", "line 1: malformed YAML"),
            ("camera: &a [*a]", r"aliases"),
            ("camera: []\ncamera: []", "twice"),
            ("camera: !!python/object/apply:os.getcwd []", "malformed YAML"),
            ("[" * 5000, "malformed YAML"),
            ("just words", "mapping"),
            ("\x01", "malformed YAML"),
        ],
    )
    def test_yaml_is_neither_run_nor_expanded(self, content, named, file, keys):
        with pytest.raises(SceneError, match=r"flight\.yaml: .*" + named):
            CameraPath(file=keys(content, "flight.yaml"), fps=24).frames_of(file, camera=0)

    @settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
    @given(content=st.binary(max_size=64), at=st.integers(0, 300), name=st.sampled_from(["a.json", "a.yaml"]))
    def test_damaged_files_are_refused_in_one_line_or_read(self, content, at, name, file, keys):
        whole = json.dumps({"camera": self.KEYS}).encode()
        path = keys("", name)
        path.write_bytes(whole[:at] + content + whole[at + len(content) :])
        try:
            frames = CameraPath(file=path, fps=1).frames_of(file, camera=0)
        except SceneError as error:
            message = str(error)
        else:
            assert np.isfinite(frames[0].c2w).all()
            return
        assert f"{name}: " in message
        assert "\n" not in message

    def test_a_path_that_makes_no_camera_on_its_way_says_when(self, file, keys):
        over = [{"time": y + 1, "position": (0, y, 1), "look_at": (0, 0, 0), "fov": 40} for y in (-1, 1)]
        frames = CameraPath(file=keys({"camera": over}), fps=1).frames_of(file, camera=0)
        with pytest.raises(SceneError, match=r"flight\.json: camera, time 1: camera: up is zero or parallel"):
            frames[1]

    def test_a_missing_file_and_an_impossible_rate_are_named(self, file, tmp_path):
        with pytest.raises(SceneError, match=r"absent\.yaml: cannot be read"):
            CameraPath(file=tmp_path / "absent.yaml", fps=24).frames_of(file, camera=0)
        with pytest.raises(SceneError, match=r"motion\.fps"):
            CameraPath(file="a.yaml", fps=0)


class TestKeyframes:
    def test_named_parts_pass_through_their_keys_and_all_else_stays(self, file, keys):
        objects = {
            "peak_1": [
                {"time": 0, "translation": [0, 0, 0.05], "rotation": [0, 0, 0]},
                {"time": 1, "diffuse": [0.1, 0.7, 0.2]},
                {"time": 2, "translation": [0.4, 0.2, 0.05], "rotation": [0, 0, 90]},
            ],
            "lamp": [{"time": 0, "emissive": [3000] * 3}, {"time": 2, "emissive": [0, 500, 1000]}],
        }
        frames = Keyframes(file=keys({"objects": objects}), fps=2).frames_of(file, camera=2)
        assert len(frames) == 5
        original = pack(load_scene(file))
        first, middle, last = frames[0], frames[2], frames[4]
        np.testing.assert_array_equal(first.c2w[0], original.c2w[2])

        mesh = of_object(first, "peak_1", first.triangles.positions) - [0, 0, 0.05]
        for frame, turned, place in ((middle, 45.0, (0.2, 0.1, 0.05)), (last, 90.0, (0.4, 0.2, 0.05))):
            expected = mesh @ rotation_matrix((0.0, 0.0, turned)).T + place
            np.testing.assert_allclose(of_object(frame, "peak_1", frame.triangles.positions), expected, atol=1e-6)
            diffuse = of_object(frame, "peak_1", frame.triangles.material)[0, :3]
            np.testing.assert_allclose(diffuse, [0.1, 0.7, 0.2], atol=1e-6)  # its only key holds throughout

        np.testing.assert_allclose(
            of_object(middle, "lamp", middle.triangles.material)[0, EMISSION], [1500, 1750, 2000]
        )
        for name in ("floor", "peak_0", "peak_2", "spot"):
            for columns in ("positions", "material"):
                mine = of_object(last, name, getattr(last.triangles, columns))
                np.testing.assert_array_equal(mine, of_object(original, name, getattr(original.triangles, columns)))

    def test_frames_in_which_nothing_changes_share_their_triangles(self, file, keys):
        objects = {"lamp": [{"time": 0, "emissive": [1000] * 3}, {"time": 1, "emissive": [900] * 3}]}
        content = {
            "objects": objects,
            "camera": [dict(k, time=t) for k, t in zip(TestCameraPath.KEYS, (0, 1, 3), strict=True)],
        }
        frames = Keyframes(file=keys(content), fps=1).frames_of(file, camera=0)
        zero, one, two, three = frames
        assert zero.triangles is not one.triangles
        assert one.triangles is two.triangles is three.triangles
        assert not np.allclose(two.c2w, three.c2w)

    @pytest.mark.parametrize(
        ("objects", "named"),
        [
            ({"peak_9": [{"time": 0}]}, r"objects\.peak_9: the scene has no such object: it has 'floor', 'lamp'"),
            ({"lamp": [{"time": 1}, {"time": 1}]}, r"objects\.lamp: time 1 follows 1"),
            ({"lamp": []}, r"objects\.lamp: there is no key"),
            ({"lamp": [{"time": 0, "emissive": [-1, 0, 0]}]}, r"objects\.lamp: key 0: emissive\.0: "),
            ({"lamp": [{"time": 0, "diffuse": [1.2, 0, 0]}]}, r"objects\.lamp: key 0: diffuse\.0: "),
            ({"lamp": [{"time": 0, "colour": [1, 0, 0]}]}, r"colour: unknown key"),
            ({"floor": [{"time": 0, "rotation": [0, 0, 0]}, {"time": 1, "rotation": [0, 0, 360]}]}, "180 degrees"),
            ({}, "objects"),
        ],
    )
    def test_a_bad_key_is_one_line_with_file_and_object(self, objects, named, file, keys):
        with pytest.raises(SceneError, match=r"flight\.json: .*" + named):
            Keyframes(file=keys({"objects": objects}), fps=24).frames_of(file, camera=0)

    def test_keys_that_reflect_too_much_are_a_warning(self, file, keys):
        objects = {"floor": [{"time": 0, "diffuse": [0.9] * 3, "specular": [0.5] * 3}]}
        with pytest.warns(UserWarning, match="'floor'.*1.4"):
            Keyframes(file=keys({"objects": objects}), fps=24).frames_of(file, camera=0)

    def test_a_scene_without_objects_cannot_be_keyed(self, keys, tmp_path):
        packed = save_h5(pack(scene()), tmp_path / "six.h5")
        with pytest.raises(SceneError, match=r"six\.h5: holds triangles but no objects"):
            Keyframes(file=keys({"objects": {"lamp": [{"time": 0}]}}), fps=24).frames_of(packed, camera=0)


class TestNumberedScenes:
    @pytest.fixture
    def folder(self, tmp_path):
        for number in (9, 10, 11):
            cameras = (Camera(position=(number, 0, 0), look_at=(0, 0, 0), fov=40),)
            save_scene(scene().model_copy(update={"cameras": cameras}), tmp_path / "film" / f"frame_{number}.json")
        return tmp_path / "film"

    def test_frames_come_in_the_order_of_their_numbers(self, folder):
        frames = NumberedScenes(pattern="*.json").frames_of(folder, camera=0)
        assert [frame.c2w[0, 0, 3] for frame in frames] == [9, 10, 11]

    @pytest.mark.parametrize(
        ("change", "named"),
        [
            (lambda f: (f / "frame_10.json").unlink(), "frame 10 is missing"),
            (
                lambda f: (f / "other_010.json").write_text("{}"),
                "has the same number as",
            ),
            (lambda f: (f / "notes.json").write_text("{}"), r"notes\.json: has no number"),
        ],
    )
    def test_gaps_twins_and_strangers_are_named(self, change, named, folder):
        change(folder)
        with pytest.raises(SceneError, match=named):
            NumberedScenes(pattern="*.json").frames_of(folder, camera=0)

    def test_nothing_to_show(self, folder):
        with pytest.raises(SceneError, match=r"film: holds no file like '\*\.glb'"):
            NumberedScenes(pattern="*.glb").frames_of(folder, camera=0)
        with pytest.raises(SceneError, match=r"frame_9\.json: is not a folder"):
            NumberedScenes(pattern="*.json").frames_of(folder / "frame_9.json", camera=0)


def test_cameras_that_are_not_there_are_refused():
    with pytest.raises(UserError, match=r"cameras=\[3\]: six\.json has cameras 0…2"):
        with_cameras(scene(), Path("six.json"), [3])
    with pytest.raises(UserError, match=r"cameras=\[\]"):
        with_cameras(scene(), Path("six.json"), [])
    with pytest.raises(UserError, match=r"six\.json: has no camera"):
        with_cameras(scene().model_copy(update={"cameras": ()}), Path("six.json"), None)
    assert len(with_cameras(scene(), Path("six.json"), [2, 0]).fov) == 2
