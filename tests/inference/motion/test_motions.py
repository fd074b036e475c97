"""Motions: turntable, swing, keyframes and numbered scenes."""

import json
from pathlib import Path

import numpy as np
import pytest
from edited_scenes import scene

from rfpp.errors import SceneError, UserError
from rfpp.inference.motion import Keyframes, NumberedScenes, Swing, Turntable
from rfpp.inference.motion.frames import with_cameras
from rfpp.scene.camera import camera_to_world
from rfpp.scene.io.loading import load_scene
from rfpp.scene.io.renderformer_h5 import save_h5
from rfpp.scene.io.saving import save_scene
from rfpp.scene.packed import pack
from rfpp.scene.spec import Camera, rotation_matrix
from rfpp.scene.triangles import EMISSION

CAMERA = (
    {"time": 1, "position": [0, -2, 0.5], "look_at": [0, 0, 0], "fov": 40},
    {"time": 1.5, "position": [1, -1.5, 0.8], "look_at": [0.1, 0, 0], "fov": 30},
    {"time": 3, "position": [2, 0, 0.5], "look_at": [0, 0, 0.1], "fov": 50},
)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """Scene file with six objects and three cameras."""
    return save_scene(scene(), tmp_path_factory.mktemp("scene") / "six.json")


@pytest.fixture
def keys(tmp_path):
    """`keys(content)`: path of a file of keyframes."""

    def write(content, name="flight.json"):
        (tmp_path / name).write_text(content if isinstance(content, str) else json.dumps(content))
        return tmp_path / name

    return write


def of_object(frame, name, columns):
    number = frame.triangles.object_names.index(name)
    return columns[slice(*frame.triangles.object_offsets[number : number + 2])]


def test_a_turntable_is_a_circle_at_constant_height(file):
    frames = Turntable(frames=12).frames_of(file, camera=1)
    poses = np.stack([frame.c2w[0] for frame in frames]).astype(np.float64)
    np.testing.assert_array_equal(poses[0], pack(load_scene(file)).c2w[1])
    for a, b in zip(poses, [*poses[1:], poses[0]], strict=True):  # equal steps close the circle
        step = b @ np.linalg.inv(a)
        np.testing.assert_allclose(step[:3, :3], rotation_matrix((0.0, 0.0, 30.0)), atol=1e-6)
    visible = frames[0].triangles.positions[~frames[0].triangles.is_emissive].reshape(-1, 3)
    offsets = poses[:, :3, 3] - (visible.min(axis=0) + visible.max(axis=0)) / 2
    np.testing.assert_allclose(offsets[:, 2], offsets[0, 2], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(offsets, axis=1), np.linalg.norm(offsets[0]), atol=1e-5)
    assert frames[0].triangles is frames[11].triangles
    with pytest.raises(IndexError):
        frames[12]


@pytest.mark.parametrize("frames", [0, -3, "many"])
def test_invalid_numbers_of_frames_are_refused(frames):
    with pytest.raises(SceneError, match=r"^motion\.frames: "):
        Turntable(frames=frames)


def test_a_swing_turns_to_both_sides_and_back(file):
    frames = Swing(frames=8, degrees=40).frames_of(file, camera=1)
    pose = frames[0].c2w[0].astype(np.float64)
    np.testing.assert_array_equal(pose, pack(load_scene(file)).c2w[1])
    for number, angle in ((2, 20.0), (4, 0.0), (6, -20.0)):
        turned = frames[number].c2w[0] @ np.linalg.inv(pose)
        np.testing.assert_allclose(turned[:3, :3], rotation_matrix((0.0, 0.0, angle)), atol=1e-6)


class TestKeyframes:
    def test_a_camera_passes_through_its_keys(self, file, keys):
        text = "camera:\n" + "".join(f"  - {json.dumps(key)}  # a comment\n" for key in CAMERA)
        frames = Keyframes(file=keys(text, "flight.yaml"), fps=4).frames_of(file, camera=0)
        assert len(frames) == 9
        for key in CAMERA:
            frame = frames[int(4 * (key["time"] - 1))]
            camera = Camera(**{name: value for name, value in key.items() if name != "time"})
            np.testing.assert_allclose(frame.c2w[0], camera_to_world(camera), atol=1e-6)
            assert frame.fov[0] == pytest.approx(camera.fov)
        assert frames[0].triangles is frames[8].triangles

    @pytest.mark.parametrize(
        ("content", "named"),
        [
            (json.dumps({"camera": CAMERA[::-1]}), "camera: time 1.5 follows 3: put the keys in order"),
            ('{"camera": []}', "camera: tuple should have at least 1 item"),
            ('{"camera": [{"time": 0}]}', "camera.0.position: this key is missing"),
            (
                '{"camera": [{"time": 1.0e+30, "position": [0, -2, 0], "look_at": [0, 0, 0], "fov": 40}]}',
                "camera.0.time",
            ),
            ('{"camera": [{"time": .nan, "position": [0, -2, 0], "look_at": [0, 0, 0], "fov": 40}]}', "finite"),
            ('{"camera": [{"time": 0, "position": [0, 0, 0], "look_at": [0, 0, 0], "fov": 40}]}', "looks nowhere"),
            ('{"camera": [{"time": 0, "position": [0, -2, 0], "look_at": [0, 0, 0], "fov": 400}]}', "fov"),
            ('{"cameras": []}', "cameras: unknown key"),
            ("{}", "neither objects nor a camera"),
            ('{"camera": ', "line 1: malformed YAML"),
            ("[1, 2]", "not a mapping"),
            ("camera: &a [*a]", "aliases"),
            ("camera: !!python/object/apply:os.getcwd []", "malformed YAML"),
            ("[" * 5000, "malformed YAML"),
            ("\x01", "malformed YAML"),
        ],
    )
    def test_an_invalid_file_is_one_line(self, content, named, file, keys):
        with pytest.raises(SceneError) as refused:
            Keyframes(file=keys(content), fps=24).frames_of(file, camera=0)
        assert "flight.json: " in str(refused.value)
        assert named in str(refused.value)
        assert "\n" not in str(refused.value)

    def test_an_impossible_camera_between_keys_is_reported_with_its_time(self, file, keys):
        over = [{"time": y + 1, "position": (0, y, 1), "look_at": (0, 0, 0), "fov": 40} for y in (-1, 1)]
        frames = Keyframes(file=keys({"camera": over}), fps=1).frames_of(file, camera=0)
        with pytest.raises(SceneError, match=r"flight\.json: camera, time 1: camera: up is zero or parallel"):
            frames[1]

    def test_a_missing_file_and_an_invalid_rate_are_named(self, file, tmp_path):
        with pytest.raises(SceneError, match=r"absent\.yaml: cannot be read"):
            Keyframes(file=tmp_path / "absent.yaml", fps=24).frames_of(file, camera=0)
        with pytest.raises(SceneError, match=r"motion\.fps"):
            Keyframes(file="a.yaml", fps=0)

    def test_named_properties_change_and_all_others_are_constant(self, file, keys):
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
            np.testing.assert_allclose(diffuse, [0.1, 0.7, 0.2], atol=1e-6)  # constant, with a single key

        np.testing.assert_allclose(
            of_object(middle, "lamp", middle.triangles.material)[0, EMISSION], [1500, 1750, 2000]
        )
        for name in ("floor", "peak_0", "peak_2", "spot"):
            for columns in ("positions", "material"):
                mine = of_object(last, name, getattr(last.triangles, columns))
                np.testing.assert_array_equal(mine, of_object(original, name, getattr(original.triangles, columns)))

    @pytest.mark.parametrize(
        ("objects", "named"),
        [
            ({"peak_9": [{"time": 0}]}, r"objects\.peak_9: the scene has no such object: it has 'floor', 'lamp'"),
            ({"lamp": [{"time": 1}, {"time": 1}]}, r"objects\.lamp: time 1 follows 1"),
            ({"lamp": [{"time": 0, "emissive": [-1, 0, 0]}]}, r"objects\.lamp\.0\.emissive\.0: "),
            ({"lamp": [{"time": 0, "diffuse": [1.2, 0, 0]}]}, r"objects\.lamp\.0\.diffuse\.0: "),
            ({"lamp": [{"time": 0, "color": [1, 0, 0]}]}, r"color: unknown key"),
            ({"floor": [{"time": 0, "rotation": [0, 0, 0]}, {"time": 1, "rotation": [0, 0, 360]}]}, "180 degrees"),
        ],
    )
    def test_an_invalid_key_is_one_line_with_file_and_object(self, objects, named, file, keys):
        with pytest.raises(SceneError, match=r"flight\.json: .*" + named):
            Keyframes(file=keys({"objects": objects}), fps=24).frames_of(file, camera=0)

    def test_a_scene_without_objects_accepts_a_camera_only(self, keys, tmp_path):
        packed = save_h5(pack(scene()), tmp_path / "six.h5")
        assert len(Keyframes(file=keys({"camera": CAMERA}), fps=1).frames_of(packed, camera=0)) == 3
        with pytest.raises(SceneError, match=r"six\.h5: holds triangles but no objects"):
            Keyframes(file=keys({"objects": {"lamp": [{"time": 0}]}}), fps=24).frames_of(packed, camera=0)


@pytest.fixture
def folder(tmp_path):
    for number in (9, 10, 11):
        cameras = (Camera(position=(number, 0, 0), look_at=(0, 0, 0), fov=40),)
        save_scene(scene().model_copy(update={"cameras": cameras}), tmp_path / "film" / f"frame_{number}.json")
    return tmp_path / "film"


def test_numbered_scenes_are_ordered_by_number(folder):
    frames = NumberedScenes(pattern="*.json").frames_of(folder, camera=0)
    assert [frame.c2w[0, 0, 3] for frame in frames] == [9, 10, 11]


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda f: (f / "frame_10.json").unlink(), "frame 10 is missing"),
        (lambda f: (f / "other_010.json").write_text("{}"), "has the same number as"),
        (lambda f: (f / "notes.json").write_text("{}"), r"notes\.json: has no number"),
        (lambda f: [file.unlink() for file in f.glob("*.json")], r"film: holds no file like '\*\.json'"),
        (lambda f: f.rename(f.with_name("other")), "film: is not a folder"),
    ],
)
def test_folders_of_other_files_are_refused(change, named, folder):
    change(folder)
    with pytest.raises(SceneError, match=named):
        NumberedScenes(pattern="*.json").frames_of(folder, camera=0)


def test_missing_cameras_are_refused():
    with pytest.raises(UserError, match=r"cameras=\[3\]: six\.json has cameras 0…2"):
        with_cameras(scene(), Path("six.json"), [3])
    with pytest.raises(UserError, match=r"cameras=\[\]"):
        with_cameras(scene(), Path("six.json"), [])
    with pytest.raises(UserError, match=r"six\.json: has no camera"):
        with_cameras(scene().model_copy(update={"cameras": ()}), Path("six.json"), None)
    assert len(with_cameras(scene(), Path("six.json"), [2, 0]).fov) == 2
