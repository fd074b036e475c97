"""The viewer's controls: layer, objects, lights, reference and export."""

from __future__ import annotations

import io
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import viser
from PIL import Image

from rfpp.errors import UserError
from rfpp.files import as_file_name
from rfpp.imaging.tone_maps import ToneMap
from rfpp.scene.io.saving import fits_json, save_scene
from rfpp.scene.packed import PackedScene, pack
from rfpp.scene.spec import Camera, Scene, SceneObject
from rfpp.viewer.comparison import COMPARISONS
from rfpp.viewer.control_values import choice, colour, number, vector
from rfpp.viewer.edits import moved, power, quaternion, remade, replaced, shining, tint, turned
from rfpp.viewer.layers import Layer
from rfpp.viewer.picked_colour import from_picker, to_picker
from rfpp.viewer.reference import PathTracer, Reference
from rfpp.viewer.session import Drawn, Session
from rfpp.viewer.viser_cameras import camera_of

#: Name → how it is made for `stops` of exposure.
ToneMaps = Mapping[str, Callable[..., ToneMap]]

_STRONGEST_LIGHT = 2.0  # times the strongest of the scene as it was loaded
_HANDLE_SIZE = 0.2  # world units


def add_view(
    gui: viser.GuiApi,
    session: Session,
    layers: Mapping[str, Layer],
    tone_maps: ToneMaps,
    cameras: tuple[Camera, ...],
    stand_at: Callable[[Camera], None],
) -> None:
    """What is shown, how bright, how large, and the scene's cameras."""
    with gui.add_folder("View"):
        what = gui.add_dropdown("Show", tuple(layers))
        tone_map = gui.add_dropdown("Tone map", tuple(tone_maps))
        stops = gui.add_slider("Exposure (stops)", min=-6.0, max=6.0, step=0.1, initial_value=0.0)
        patch = session.pacing.patch
        sides = {"min": 8 * patch, "max": max(512, session.view.longer_side), "step": patch}
        side = gui.add_slider("Longer side (pixels)", **sides, initial_value=session.view.longer_side)
        names = tuple(f"camera {i}" for i in range(len(cameras)))
        where = gui.add_button_group("Go to", names)

    what.on_update(lambda _: session.change(layer=layers[choice(what)]))
    side.on_update(lambda _: session.change(longer_side=round(number(side))))
    for handle in (tone_map, stops):
        handle.on_update(lambda _: session.change(tone_map=tone_maps[choice(tone_map)](stops=number(stops))))
    where.on_click(lambda _: stand_at(cameras[names.index(choice(where))]))


class ObjectControls:
    """One object at a time: where it stands, what it is made of, and how it shines."""

    def __init__(self, client: viser.ClientHandle, session: Session, scene: Scene, complain: Callable[[str], None]):
        gui = client.gui
        self._session, self._complain = session, complain
        self._filling = False
        lights = sorted((item for item in scene.objects if item.material.is_emissive), key=power, reverse=True)
        others = [item for item in scene.objects if not item.material.is_emissive]
        brightest = power(lights[0]) if lights else 1.0
        with gui.add_folder("Objects and lights"):
            self.name = gui.add_dropdown("Object", tuple(item.name for item in (*lights, *others)))
            drag = gui.add_checkbox("Drag in the picture", initial_value=False)
            self.translation = gui.add_vector3("Position", (0.0, 0.0, 0.0), step=0.01)
            self.rotation = gui.add_vector3("Rotation (degrees)", (0.0, 0.0, 0.0), step=1.0)
            self.scale = gui.add_vector3("Scale", (1.0, 1.0, 1.0), step=0.01)
            self.diffuse = gui.add_rgb("Diffuse", (0, 0, 0))
            self.specular = gui.add_rgb("Specular", (0, 0, 0))
            self.roughness = gui.add_slider("Roughness", min=0.0, max=1.0, step=0.01, initial_value=0.5)
            self.power = gui.add_slider(
                "Light power", min=0.0, max=_STRONGEST_LIGHT * brightest, step=brightest / 200, initial_value=0.0
            )
            self.tint = gui.add_rgb("Light colour", (255, 255, 255))
            undo = gui.add_button("Undo all edits")
        self.handles = client.scene.add_transform_controls(
            "/object", scale=_HANDLE_SIZE, depth_test=False, visible=drag.value
        )

        self.name.on_update(lambda _: self._fill())
        for handle in (self.translation, self.rotation, self.scale):
            handle.on_update(lambda _: self._edit(self._moved))
        for handle in (self.diffuse, self.specular, self.roughness):
            handle.on_update(lambda _: self._edit(self._remade))
        for handle in (self.power, self.tint):
            handle.on_update(lambda _: self._edit(self._shining))
        undo.on_click(lambda _: self._reset(scene))
        drag.on_update(lambda _: setattr(self.handles, "visible", drag.value))
        self.handles.on_update(lambda _: self._dragged())
        self._fill()

    def _item(self) -> SceneObject:
        name = choice(self.name)
        return next(item for item in self._session.view.scene.objects if item.name == name)

    def _fill(self) -> None:
        """Show the chosen object's values."""
        item = self._item()
        self._place_handles(item)
        self._filling = True  # setting a value calls what hears of its changes
        try:
            self.translation.value, self.rotation.value = item.transform.translation, item.transform.rotation
            self.scale.value = item.transform.scale
            self.diffuse.value, self.specular.value = map(to_picker, (item.material.diffuse, item.material.specular))
            self.roughness.value = item.material.roughness
            self.power.value, self.tint.value = min(power(item), self.power.max), to_picker(tint(item))
        finally:
            self._filling = False

    def _edit(self, edited: Callable[[SceneObject], SceneObject]) -> None:
        if self._filling:
            return
        try:
            item = edited(self._item())
            self._session.change(scene=replaced(self._session.view.scene, item))
        except UserError as error:
            self._complain(str(error))
        else:
            self._place_handles(item)

    def _place_handles(self, item: SceneObject) -> None:
        self.handles.position, self.handles.wxyz = item.transform.translation, quaternion(item.transform)

    def _dragged(self) -> None:
        """Where the handles are now, the object is to be."""
        self._filling = True
        try:
            self.translation.value = tuple(self.handles.position.tolist())
            self.rotation.value = turned(self.handles.wxyz)
        finally:
            self._filling = False
        item = self._item()
        if (there := self._moved(item)).transform != item.transform:  # they are let go where they were
            self._session.change(scene=replaced(self._session.view.scene, there))

    def _moved(self, item: SceneObject) -> SceneObject:
        parts = {"translation": self.translation, "rotation": self.rotation, "scale": self.scale}
        return moved(item, **{name: vector(handle) for name, handle in parts.items()})

    def _remade(self, item: SceneObject) -> SceneObject:
        """Only the value that was changed: pickers hold eight bits, and an object's faces may differ."""
        material = item.material
        changed = {
            name: from_picker(colour(handle))
            for name, handle in (("diffuse", self.diffuse), ("specular", self.specular))
            if colour(handle) != to_picker(getattr(material, name))
        }
        return remade(item, **changed, roughness=number(self.roughness))

    def _shining(self, item: SceneObject) -> SceneObject:
        return shining(item, number(self.power), from_picker(colour(self.tint)))

    def _reset(self, scene: Scene) -> None:
        self._session.change(scene=scene)
        self._fill()


def add_reference(
    gui: viser.GuiApi, session: Session, tracer: PathTracer, complain: Callable[[str], None]
) -> Callable[[Drawn], None]:
    """Path tracing and comparison; returns what is to be told of every picture."""
    with gui.add_folder("Path-traced reference"):
        trace = gui.add_button(f"Path-trace this view ({tracer.settings.samples} samples)")
        comparison = gui.add_dropdown("Compare", ("off", *COMPARISONS), initial_value="wipe")
        share = gui.add_slider("Wipe", min=0.0, max=1.0, step=0.01, initial_value=0.5)
        status = gui.add_markdown("None yet.")

    def done(reference: Reference) -> None:
        trace.disabled = False
        session.change(reference=reference, comparison=COMPARISONS.get(choice(comparison)))

    def failed(message: str) -> None:
        trace.disabled = False
        status.content = "None yet."
        complain(message)

    def begin(_: object) -> None:
        view, trace.disabled = session.view, True
        status.content = "Path tracing …"
        size = session.pacing.size(view.longer_side, view.aspect)
        tracer.trace(session.packed(view), view.scene, view.camera, size, done, failed)

    def told(drawn: Drawn) -> None:
        reference = session.view.reference
        if reference and not trace.disabled:
            took = f"Path-traced in {reference.seconds:.1f} s"
            status.content = f"{took}." if drawn.compared or comparison.value == "off" else f"{took}, of another view."

    trace.on_click(begin)
    comparison.on_update(lambda _: session.change(comparison=COMPARISONS.get(choice(comparison))))
    share.on_update(lambda _: session.change(share=number(share)))
    return told


def add_saving(gui: viser.GuiApi, client: viser.ClientHandle, session: Session, newest: Callable[[], Drawn]) -> None:
    """The picture as PNG; the scene, with its edits and the visitor's camera, as JSON with its meshes, or as H5."""
    with gui.add_folder("Save"):
        picture, scene = gui.add_button("Picture (PNG)"), gui.add_button("Scene")

    def send_picture(_: object) -> None:
        stream = io.BytesIO()
        Image.fromarray(np.asarray(newest().picture)).save(stream, format="png")
        client.send_file_download(f"{as_file_name(session.view.scene.name)}.png", stream.getvalue())

    def send_scene(_: object) -> None:
        name, content = scene_file(session.view.scene, camera_of(client))
        client.send_file_download(name, content)

    picture.on_click(send_picture)
    scene.on_click(send_scene)


def scene_file(scene: Scene | PackedScene, camera: Camera) -> tuple[str, bytes]:
    """Name and bytes of a file that holds the scene, with this camera: an archive of JSON and meshes, or H5."""
    stem = as_file_name(scene.name)
    with tempfile.TemporaryDirectory() as folder:
        if not fits_json(scene):
            return f"{stem}.h5", save_scene(pack(scene).seen_by([camera]), Path(folder) / "scene.h5").read_bytes()
        save_scene(Scene(name=scene.name, objects=scene.objects, cameras=(camera,)), Path(folder) / f"{stem}.json")
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
            for file in sorted(path for path in Path(folder).rglob("*") if path.is_file()):
                archive.write(file, file.relative_to(folder))
        return f"{stem}.zip", stream.getvalue()
